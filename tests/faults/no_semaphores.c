/* A machine whose /dev/shm cannot be written, for a process that loads this before libc. */
#include <errno.h>
#include <semaphore.h>

sem_t *sem_open(const char *name, int flags, ...)
{
    (void)name;
    (void)flags;
    errno = EROFS;
    return SEM_FAILED;
}
