/* FMI 2.0, model exchange and co-simulation. */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "instance.h"

#define I ((Instance *)c)
#define STATUS(worked) ((worked) ? fmi2OK : fmi2Error)
/* Importers bind every function of the version; what this model has no use for refuses. */
#define REFUSE(name, ...) fmi2Status name(fmi2Component c, __VA_ARGS__) \
    { return STATUS(instance_refuse(I, #name ": not offered by this model")); }

void report(const Instance *instance, const char *text)
{
    fmi2CallbackLogger logger = (fmi2CallbackLogger)instance->logger;

    if (logger)
        logger(instance->environment, instance->name, fmi2Error, "logStatusError", text);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count,
                               const fmi2String categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token,
                              fmi2String resources, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean logging)
{
    (void)type, (void)resources, (void)visible, (void)logging;
    if (!functions)
        return instance_create(token, name, NULL, NULL);
    return instance_create(token, name, (Logger)functions->logger,
                           functions->componentEnvironment);
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    I->state.time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    I->state.initialised = 1;
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { instance_reset(I); return fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       fmi2Real value[])
{
    size_t i;

    for (i = 0; i < count; i++)
        if (!instance_get(I, vr[i], value + i))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       const fmi2Real value[])
{
    size_t i;

    for (i = 0; i < count; i++)
        if (!instance_set(I, vr[i], value[i]))
            return fmi2Error;
    return fmi2OK;
}

#define NO_TYPE(type) \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t count, \
                             fmi2##type value[]) \
    { \
        (void)vr, (void)value; \
        return STATUS(!count || instance_refuse(I, "there is no variable of type " #type)); \
    } \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t count, \
                             const fmi2##type value[]) \
    { \
        (void)vr, (void)value; \
        return STATUS(!count || instance_refuse(I, "there is no variable of type " #type)); \
    }
NO_TYPE(Integer)
NO_TYPE(Boolean)
NO_TYPE(String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *copy)
{
    if (!*copy && !(*copy = malloc(sizeof(State))))
        return fmi2Error;
    memcpy(*copy, &I->state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate copy)
{
    instance_restore(I, copy);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *copy)
{
    (void)c;
    free(*copy);
    *copy = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate copy, size_t *size)
{
    (void)c, (void)copy;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate copy, fmi2Byte bytes[],
                                 size_t size)
{
    if (size < sizeof(State))
        return STATUS(instance_refuse(I, "the serialised state needs more room"));
    memcpy(bytes, copy, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *copy)
{
    if (size != sizeof(State))
        return STATUS(instance_refuse(I, "the serialised state is of another model"));
    if (!*copy && !(*copy = malloc(sizeof(State))))
        return fmi2Error;
    memcpy(*copy, bytes, sizeof(State));
    return fmi2OK;
}

REFUSE(fmi2GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t unknowns,
       const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[], fmi2Real result[])

/* Model exchange: no events of its own. */
fmi2Status fmi2EnterEventMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *events)
{
    (void)c;
    memset(events, 0, sizeof *events);
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final,
                                       fmi2Boolean *enter_event_mode, fmi2Boolean *terminate)
{
    (void)c, (void)final;
    *enter_event_mode = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    I->state.time = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t count)
{
    return STATUS(instance_set_states(I, x, count));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t count)
{
    return STATUS(instance_get_states(I, x, count));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real slope[], size_t count)
{
    return STATUS(instance_get_slopes(I, slope, count));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t count)
{
    return STATUS(instance_get_nominals(I, nominal, count));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicator[], size_t count)
{
    (void)indicator;
    return STATUS(!count || instance_refuse(I, "there are no event indicators"));
}

/* Co-simulation. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real duration, fmi2Boolean final)
{
    (void)now, (void)final;
    return STATUS(instance_move(I, duration));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return STATUS(instance_refuse(I, "fmi2CancelStep: steps are never pending"));
}

REFUSE(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t count,
       const fmi2Integer order[], const fmi2Real value[])
REFUSE(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t count,
       const fmi2Integer order[], fmi2Real value[])
REFUSE(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
REFUSE(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
REFUSE(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
REFUSE(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
REFUSE(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
