/* A disk with bad sectors, for a process that loads this before libc (LD_PRELOAD).
 *
 * The file that BAD_SECTORS names has one line for each: "INODE FIRST LAST", the first byte and
 * the one behind the last. Reading or writing any of them fails with EIO, from when the line
 * is there until it is gone.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

static int is_bad(int descriptor, size_t count, off64_t at)
{
    struct stat64 status;
    unsigned long long inode;
    long long first, last;
    int found = 0;
    const char *list = getenv("BAD_SECTORS");
    FILE *file = list ? fopen(list, "r") : NULL;
    if (!file)
        return 0;
    if (fstat64(descriptor, &status) == 0)
        while (fscanf(file, "%llu %lld %lld", &inode, &first, &last) == 3)
            found |= inode == status.st_ino && at < last && at + (off64_t)count > first;
    fclose(file);
    return found;
}

ssize_t pread64(int descriptor, void *buffer, size_t count, off64_t at)
{
    static ssize_t (*next)(int, void *, size_t, off64_t);
    if (!next)
        next = dlsym(RTLD_NEXT, "pread64");
    if (is_bad(descriptor, count, at)) {
        errno = EIO;
        return -1;
    }
    return next(descriptor, buffer, count, at);
}

ssize_t pwrite64(int descriptor, const void *buffer, size_t count, off64_t at)
{
    static ssize_t (*next)(int, const void *, size_t, off64_t);
    if (!next)
        next = dlsym(RTLD_NEXT, "pwrite64");
    if (is_bad(descriptor, count, at)) {
        errno = EIO;
        return -1;
    }
    return next(descriptor, buffer, count, at);
}

ssize_t read(int descriptor, void *buffer, size_t count)
{
    static ssize_t (*next)(int, void *, size_t);
    if (!next)
        next = dlsym(RTLD_NEXT, "read");
    off64_t at = lseek64(descriptor, 0, SEEK_CUR);
    if (at >= 0 && is_bad(descriptor, count, at)) {
        errno = EIO;
        return -1;
    }
    return next(descriptor, buffer, count);
}

/* SQLite asks for one or the other, as it was built. */
ssize_t pread(int descriptor, void *buffer, size_t count, off_t at)
{
    return pread64(descriptor, buffer, count, at);
}

ssize_t pwrite(int descriptor, const void *buffer, size_t count, off_t at)
{
    return pwrite64(descriptor, buffer, count, at);
}
