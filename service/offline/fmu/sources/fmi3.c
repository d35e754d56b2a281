/* FMI 3.0, model exchange and co-simulation. */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "instance.h"

#define I ((Instance *)c)
#define STATUS(worked) ((worked) ? fmi3OK : fmi3Error)
/* Importers bind every function of the version; what this model has no use for refuses. */
#define REFUSE(name, ...) fmi3Status name(fmi3Instance c, __VA_ARGS__) \
    { return STATUS(instance_refuse(I, #name ": not offered by this model")); }
#define ACCEPT(name) fmi3Status name(fmi3Instance c) { (void)c; return fmi3OK; }

void report(const Instance *instance, const char *text)
{
    fmi3LogMessageCallback logger = (fmi3LogMessageCallback)instance->logger;

    if (logger)
        logger(instance->environment, fmi3Error, "logStatusError", text);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t count,
                               const fmi3String categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token,
    fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger)
{
    (void)resources, (void)visible, (void)logging;
    return instance_create(token, name, (Logger)logger, environment);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token,
    fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
    fmi3Boolean early_return, const fmi3ValueReference intermediate[], size_t count,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
    fmi3IntermediateUpdateCallback update)
{
    (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)count, (void)update;
    return instance_create(token, name, (Logger)logger, environment);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token,
    fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
    fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)environment, (void)logger, (void)update, (void)lock, (void)unlock;
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance,
    fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    I->state.time = start;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    I->state.initialised = 1;
    return fmi3OK;
}

ACCEPT(fmi3EnterEventMode)
ACCEPT(fmi3Terminate)
ACCEPT(fmi3EnterConfigurationMode)
ACCEPT(fmi3ExitConfigurationMode)
ACCEPT(fmi3EvaluateDiscreteStates)
ACCEPT(fmi3EnterContinuousTimeMode)
ACCEPT(fmi3EnterStepMode)
fmi3Status fmi3Reset(fmi3Instance c) { instance_reset(I); return fmi3OK; }

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t count,
                          fmi3Float64 value[], size_t values)
{
    size_t i;

    if (values != count)
        return STATUS(instance_refuse(I, "every variable has one value"));
    for (i = 0; i < count; i++)
        if (!instance_get(I, vr[i], value + i))
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t count,
                          const fmi3Float64 value[], size_t values)
{
    size_t i;

    if (values != count)
        return STATUS(instance_refuse(I, "every variable has one value"));
    for (i = 0; i < count; i++)
        if (!instance_set(I, vr[i], value[i]))
            return fmi3Error;
    return fmi3OK;
}

#define NO_TYPE(type) \
    fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference vr[], size_t count, \
                             fmi3##type value[], size_t values) \
    { \
        (void)vr, (void)value, (void)values; \
        return STATUS(!count || instance_refuse(I, "there is no variable of type " #type)); \
    } \
    fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference vr[], size_t count, \
                             const fmi3##type value[], size_t values) \
    { \
        (void)vr, (void)value, (void)values; \
        return STATUS(!count || instance_refuse(I, "there is no variable of type " #type)); \
    }
NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(Boolean)
NO_TYPE(String)
REFUSE(fmi3GetBinary, const fmi3ValueReference vr[], size_t count, size_t sizes[],
       fmi3Binary value[], size_t values)
REFUSE(fmi3SetBinary, const fmi3ValueReference vr[], size_t count, const size_t sizes[],
       const fmi3Binary value[], size_t values)
REFUSE(fmi3GetClock, const fmi3ValueReference vr[], size_t count, fmi3Clock value[])
REFUSE(fmi3SetClock, const fmi3ValueReference vr[], size_t count, const fmi3Clock value[])
REFUSE(fmi3GetIntervalDecimal, const fmi3ValueReference vr[], size_t count,
       fmi3Float64 interval[], fmi3IntervalQualifier qualifier[])
REFUSE(fmi3GetIntervalFraction, const fmi3ValueReference vr[], size_t count,
       fmi3UInt64 counter[], fmi3UInt64 resolution[], fmi3IntervalQualifier qualifier[])
REFUSE(fmi3GetShiftDecimal, const fmi3ValueReference vr[], size_t count, fmi3Float64 shift[])
REFUSE(fmi3GetShiftFraction, const fmi3ValueReference vr[], size_t count, fmi3UInt64 counter[],
       fmi3UInt64 resolution[])
REFUSE(fmi3SetIntervalDecimal, const fmi3ValueReference vr[], size_t count,
       const fmi3Float64 interval[])
REFUSE(fmi3SetIntervalFraction, const fmi3ValueReference vr[], size_t count,
       const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
REFUSE(fmi3SetShiftDecimal, const fmi3ValueReference vr[], size_t count,
       const fmi3Float64 shift[])
REFUSE(fmi3SetShiftFraction, const fmi3ValueReference vr[], size_t count,
       const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
REFUSE(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *count)
REFUSE(fmi3GetVariableDependencies, fmi3ValueReference vr, size_t elements[],
       fmi3ValueReference independent[], size_t independent_elements[],
       fmi3DependencyKind kind[], size_t count)
REFUSE(fmi3GetDirectionalDerivative, const fmi3ValueReference unknown[], size_t unknowns,
       const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[], size_t seeds,
       fmi3Float64 result[], size_t results)
REFUSE(fmi3GetAdjointDerivative, const fmi3ValueReference unknown[], size_t unknowns,
       const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[], size_t seeds,
       fmi3Float64 result[], size_t results)
REFUSE(fmi3GetOutputDerivatives, const fmi3ValueReference vr[], size_t count,
       const fmi3Int32 order[], fmi3Float64 value[], size_t values)
REFUSE(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *copy)
{
    if (!*copy && !(*copy = malloc(sizeof(State))))
        return fmi3Error;
    memcpy(*copy, &I->state, sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState copy)
{
    instance_restore(I, copy);
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *copy)
{
    (void)c;
    free(*copy);
    *copy = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState copy, size_t *size)
{
    (void)c, (void)copy;
    *size = sizeof(State);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState copy, fmi3Byte bytes[],
                                 size_t size)
{
    if (size < sizeof(State))
        return STATUS(instance_refuse(I, "the serialised state needs more room"));
    memcpy(bytes, copy, sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *copy)
{
    if (size != sizeof(State))
        return STATUS(instance_refuse(I, "the serialised state is of another model"));
    if (!*copy && !(*copy = malloc(sizeof(State))))
        return fmi3Error;
    memcpy(*copy, bytes, sizeof(State));
    return fmi3OK;
}

/* Model exchange: no events of its own. */
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
    fmi3Boolean *nominals_changed, fmi3Boolean *values_changed, fmi3Boolean *has_next,
    fmi3Float64 *next)
{
    (void)c;
    *again = *terminate = *nominals_changed = *values_changed = *has_next = fmi3False;
    *next = 0.0;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean final,
                                       fmi3Boolean *enter_event_mode, fmi3Boolean *terminate)
{
    (void)c, (void)final;
    *enter_event_mode = *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
    I->state.time = time;
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t count)
{
    return STATUS(instance_set_states(I, x, count));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t count)
{
    return STATUS(instance_get_states(I, x, count));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 slope[], size_t count)
{
    return STATUS(instance_get_slopes(I, slope, count));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominal[],
                                             size_t count)
{
    return STATUS(instance_get_nominals(I, nominal, count));
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *count)
{
    (void)c;
    *count = STATES;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *count)
{
    (void)c;
    *count = 0;
    return fmi3OK;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicator[], size_t count)
{
    (void)indicator;
    return STATUS(!count || instance_refuse(I, "there are no event indicators"));
}

/* Co-simulation. */
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 duration, fmi3Boolean final,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                      fmi3Float64 *last)
{
    int worked = instance_move(I, duration);

    (void)now, (void)final;
    *event = *terminate = *early = fmi3False;
    *last = I->state.time;
    return STATUS(worked);
}
