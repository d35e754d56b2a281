#include "instance.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NOMINAL_C 100.0
#define NOMINAL_REVOLUTIONS 1e6

int instance_refuse(Instance *instance, const char *text)
{
    report(instance, text);
    return 0;
}

static int refuse_reference(Instance *instance, const char *what, unsigned reference)
{
    char text[120];

    snprintf(text, sizeof text, "value reference %u: %s", reference, what);
    return instance_refuse(instance, text);
}

void instance_restore(Instance *instance, const State *state)
{
    instance->state = *state;
    instance->has_parameters = instance->has_point = instance->has_modes = 0;
}

static void restart(State *state)
{
    int i;

    for (i = 0; i < NODES; i++)
        state->motion.temperature[i] = state->initial[0];
    state->motion.revolutions = state->initial[1];
    state->motion.step = state->motion.coarse = 0.0;
}

void instance_reset(Instance *instance)
{
    State state;

    memset(&state, 0, sizeof state);
    memcpy(state.input, INPUT_START, sizeof state.input);
    memcpy(state.parameter, PARAMETER_START, sizeof state.parameter);
    memcpy(state.initial, INITIAL_START, sizeof state.initial);
    restart(&state);
    instance_restore(instance, &state);
}

Instance *instance_create(const char *token, const char *name, Logger logger, void *environment)
{
    Instance *instance = calloc(1, sizeof *instance);

    if (!instance)
        return NULL;
    snprintf(instance->name, sizeof instance->name, "%s", name ? name : "");
    instance->logger = logger;
    instance->environment = environment;
    if (!token || strcmp(token, TOKEN) != 0) {
        report(instance, "the model description is of another model than the library");
        free(instance);
        return NULL;
    }
    instance_reset(instance);
    return instance;
}

/* Brings the network to the parameters and inputs of the state. */
static const Network *network_of(Instance *instance)
{
    if (!instance->has_parameters)
        apply_parameters(&instance->network, instance->state.parameter);
    if (!instance->has_parameters || !instance->has_point) {
        apply_operating_point(&instance->network, instance->state.input);
        instance->has_modes = 0;
    }
    instance->has_parameters = instance->has_point = 1;
    return &instance->network;
}

static double sensor_reading(const Motion *motion, int sensor)
{
    double total = 0.0;
    int i;

    for (i = 0; i < NODES; i++)
        total += SENSOR[sensor][i] * motion->temperature[i];
    return total;
}

int instance_get(Instance *instance, unsigned reference, double *value)
{
    const State *state = &instance->state;
    double slope[STATES];

    if (reference < NODES) {
        *value = state->motion.temperature[reference];
    } else if (reference == NODES) {
        *value = state->motion.revolutions;
    } else if (reference < STATES + SENSORS) {
        *value = sensor_reading(&state->motion, (int)reference - STATES);
    } else if (reference >= FIRST_DERIVATIVE && reference < FIRST_DERIVATIVE + STATES) {
        instance_get_slopes(instance, slope, STATES);
        *value = slope[reference - FIRST_DERIVATIVE];
    } else if (reference >= FIRST_INPUT && reference < FIRST_INPUT + ALL_INPUTS) {
        *value = state->input[reference - FIRST_INPUT];
    } else if (reference >= FIRST_PARAMETER && reference < FIRST_PARAMETER + PARAMETERS) {
        *value = state->parameter[reference - FIRST_PARAMETER];
    } else if (reference == INITIAL_TEMPERATURE || reference == INITIAL_REVOLUTIONS) {
        *value = state->initial[reference - INITIAL_TEMPERATURE];
    } else if (reference == INDEPENDENT_TIME) {
        *value = state->time;
    } else {
        return refuse_reference(instance, "is no variable of this model", reference);
    }
    return 1;
}

/* Whether the network itself changes with an input: all but boundaries and the ambient. */
static int shapes_network(int input)
{
    int e;

    if (input == SPEED_INPUT || input == LOAD_INPUT)
        return 1;
    for (e = 0; e < EDGES; e++)
        if (EDGE[e].input >= 0 && EDGE[e].input == input - FIRST_OWN_INPUT)
            return 1;
    return 0;
}

int instance_set(Instance *instance, unsigned reference, double value)
{
    State *state = &instance->state;

    if (!isfinite(value))
        return refuse_reference(instance, "expected a finite number", reference);
    if (reference >= FIRST_INPUT && reference < FIRST_INPUT + ALL_INPUTS) {
        int input = (int)reference - FIRST_INPUT;
        if (state->input[input] != value && shapes_network(input))
            instance->has_point = 0;
        state->input[input] = value;
    } else if (reference >= FIRST_PARAMETER && reference < FIRST_PARAMETER + PARAMETERS) {
        state->parameter[reference - FIRST_PARAMETER] = value;
        state->motion.coarse = 0.0;
        instance->has_parameters = 0;
    } else if (reference == INITIAL_TEMPERATURE || reference == INITIAL_REVOLUTIONS) {
        if (state->initialised)
            return refuse_reference(instance, "can be set before the start only", reference);
        state->initial[reference - INITIAL_TEMPERATURE] = value;
        restart(state);
    } else {
        return refuse_reference(instance, "cannot be set", reference);
    }
    return 1;
}

int instance_move(Instance *instance, double duration)
{
    if (!(duration >= 0.0) || !isfinite(duration))
        return instance_refuse(instance, "communication step: expected 0 s or more");
    network_of(instance);
    if (!instance->has_modes && !decompose(&instance->network))
        return instance_refuse(instance, "the network has no modes: parameters out of range");
    instance->has_modes = 1;
    switch (move(&instance->network, instance->state.input, duration, &instance->state.motion)) {
    case RUNS_AWAY:
        return instance_refuse(instance, "the temperatures run away");
    case TOO_FAST:
        return instance_refuse(instance, "the temperatures change too fast to be followed: "
                                         "expected parameters between their min and max");
    }
    instance->state.time += duration;
    return 1;
}

int instance_set_states(Instance *instance, const double *value, size_t count)
{
    size_t i;

    if (count != STATES)
        return instance_refuse(instance, "wrong number of continuous states");
    for (i = 0; i < STATES; i++)
        if (!isfinite(value[i]))
            return instance_refuse(instance, "a continuous state is not a finite number");
    memcpy(instance->state.motion.temperature, value, NODES * sizeof *value);
    instance->state.motion.revolutions = value[NODES];
    return 1;
}

int instance_get_states(Instance *instance, double *value, size_t count)
{
    if (count != STATES)
        return instance_refuse(instance, "wrong number of continuous states");
    memcpy(value, instance->state.motion.temperature, NODES * sizeof *value);
    value[NODES] = instance->state.motion.revolutions;
    return 1;
}

int instance_get_slopes(Instance *instance, double *value, size_t count)
{
    if (count != STATES)
        return instance_refuse(instance, "wrong number of continuous states");
    slopes(network_of(instance), instance->state.input, &instance->state.motion, value);
    value[NODES] = fabs(instance->state.input[SPEED_INPUT]) / 60.0;
    return 1;
}

int instance_get_nominals(Instance *instance, double *value, size_t count)
{
    size_t i;

    if (count != STATES)
        return instance_refuse(instance, "wrong number of continuous states");
    for (i = 0; i < NODES; i++)
        value[i] = NOMINAL_C;
    value[NODES] = NOMINAL_REVOLUTIONS;
    return 1;
}
