/* One machine: its variables by their references, and its course over time. Both versions of the
   interface stand on this. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>

#include "network.h"

/* Value references: the temperatures of the nodes, the revolutions, then sensors that are no
   nodes; and from these numbers on: */
#define FIRST_DERIVATIVE 1000
#define FIRST_INPUT 2000
#define FIRST_PARAMETER 3000
#define INITIAL_TEMPERATURE 4000
#define INITIAL_REVOLUTIONS 4001
#define INDEPENDENT_TIME 9999

#define STATES (NODES + 1)

extern const double SENSOR[][NODES]; /* weights of the nodes */
extern const double INPUT_START[ALL_INPUTS];
extern const double PARAMETER_START[];
extern const double INITIAL_START[2];

/* All that a copy of the state keeps; plain numbers. */
typedef struct {
    int initialised;
    double time, input[ALL_INPUTS], parameter[PARAMETERS], initial[2];
    Motion motion;
} State;

typedef void (*Logger)(void); /* of the interface's own type */

typedef struct {
    State state;
    Network network;
    int has_parameters, has_point, has_modes; /* what of the network fits the state */
    char name[64];
    Logger logger;
    void *environment;
} Instance;

/* Gives the caller the reason of a refusal; each version of the interface has its own. */
void report(const Instance *instance, const char *text);

/* NULL where the token is another model's, or without memory. */
Instance *instance_create(const char *token, const char *name, Logger logger, void *environment);
void instance_reset(Instance *instance);
void instance_restore(Instance *instance, const State *state);

/* These give 0 after a report where a reference or a value cannot be used. */
int instance_get(Instance *instance, unsigned reference, double *value);
int instance_set(Instance *instance, unsigned reference, double value);
int instance_move(Instance *instance, double duration);
int instance_set_states(Instance *instance, const double *value, size_t count);
int instance_get_states(Instance *instance, double *value, size_t count);
int instance_get_slopes(Instance *instance, double *value, size_t count);
int instance_get_nominals(Instance *instance, double *value, size_t count);
int instance_refuse(Instance *instance, const char *text);

#endif
