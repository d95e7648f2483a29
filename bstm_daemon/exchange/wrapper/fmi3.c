/* FMI 3.0 for co-simulation: the types and functions of its standard headers,
 * as far as this model uses them.
 */
#include <stdbool.h>
#include <stdlib.h>

#include "instance.h"

typedef int Status;
typedef void (*Logger)(void *environment, Status status,
                       const char *category, const char *text);

#define FMI3(type, name) FMU_EXPORT type fmi3##name

static void write_log(const Instance *o, int status, const char *text)
{
    const Logger logger = (Logger)o->logger;
    if (logger != NULL)
        logger(o->environment, status,
               status == FMU_WARNING ? "logStatusWarning" : "logStatusError",
               text);
}

FMI3(const char *, GetVersion)(void) { return "3.0"; }

FMI3(void *, InstantiateCoSimulation)(
    const char *name, const char *token, const char *resources, bool visible,
    bool logging, bool event_mode, bool early_return,
    const uint32_t *intermediate, size_t n, void *environment,
    Logger logger, void *intermediate_update)
{
    (void)resources, (void)visible, (void)logging, (void)event_mode;
    (void)early_return, (void)intermediate, (void)n;
    (void)intermediate_update;
    return instance_new(name, token, environment, (void *)logger, write_log);
}

FMI3(void, FreeInstance)(void *o) { instance_free(o); }

FMI3(Status, SetDebugLogging)(void *o, bool on, size_t n,
                              const char *const *categories)
{
    (void)o, (void)on, (void)n, (void)categories;
    return FMU_OK;
}

FMI3(Status, EnterInitializationMode)(void *o, bool with_tolerance,
                                      double tolerance, double start_s,
                                      bool with_stop, double stop_s)
{
    (void)with_tolerance, (void)tolerance, (void)with_stop, (void)stop_s;
    return instance_start(o, start_s);
}

FMI3(Status, ExitInitializationMode)(void *o) { (void)o; return FMU_OK; }
FMI3(Status, Terminate)(void *o) { (void)o; return FMU_OK; }
FMI3(Status, Reset)(void *o) { instance_reset(o); return FMU_OK; }

FMI3(Status, GetFloat64)(void *o, const uint32_t *references, size_t n,
                         double *values, size_t count)
{
    if (n != count) return instance_refuse(o, "all variables are scalars");
    return instance_get(o, references, n, values);
}

FMI3(Status, SetFloat64)(void *o, const uint32_t *references, size_t n,
                         const double *values, size_t count)
{
    if (n != count) return instance_refuse(o, "all variables are scalars");
    return instance_set(o, references, n, values);
}

#define NO_ACCESS(name, ...)                                              \
    FMI3(Status, name)(void *o, const uint32_t *references, size_t n,     \
                       __VA_ARGS__)                                       \
    {                                                                     \
        (void)references;                                                 \
        return n == 0 ? FMU_OK                                            \
                      : instance_refuse(o, #name ": all variables are "   \
                                                 "Float64");              \
    }
#define NO_TYPE(name, type)                                               \
    NO_ACCESS(Get##name, type *values, size_t count)                      \
    NO_ACCESS(Set##name, const type *values, size_t count)
NO_TYPE(Float32, float)
NO_TYPE(Int8, int8_t)
NO_TYPE(UInt8, uint8_t)
NO_TYPE(Int16, int16_t)
NO_TYPE(UInt16, uint16_t)
NO_TYPE(Int32, int32_t)
NO_TYPE(UInt32, uint32_t)
NO_TYPE(Int64, int64_t)
NO_TYPE(UInt64, uint64_t)
NO_TYPE(Boolean, bool)
NO_TYPE(String, char *)
NO_ACCESS(GetBinary, size_t *sizes, const uint8_t **values, size_t count)
NO_ACCESS(SetBinary, const size_t *sizes, const uint8_t *const *values,
          size_t count)
NO_ACCESS(GetClock, bool *values)
NO_ACCESS(SetClock, const bool *values)
NO_ACCESS(GetIntervalDecimal, double *intervals, int *qualifiers)
NO_ACCESS(GetIntervalFraction, uint64_t *counters, uint64_t *resolutions,
          int *qualifiers)
NO_ACCESS(GetShiftDecimal, double *shifts)
NO_ACCESS(GetShiftFraction, uint64_t *counters, uint64_t *resolutions)
NO_ACCESS(SetIntervalDecimal, const double *intervals)
NO_ACCESS(SetIntervalFraction, const uint64_t *counters,
          const uint64_t *resolutions)
NO_ACCESS(SetShiftDecimal, const double *shifts)
NO_ACCESS(SetShiftFraction, const uint64_t *counters,
          const uint64_t *resolutions)
NO_ACCESS(GetOutputDerivatives, const int32_t *orders, double *values,
          size_t count)
NO_ACCESS(GetDirectionalDerivative, const uint32_t *knowns, size_t m,
          const double *seed, size_t seeds, double *values, size_t count)
NO_ACCESS(GetAdjointDerivative, const uint32_t *knowns, size_t m,
          const double *seed, size_t seeds, double *values, size_t count)

#define NO_FUNCTION(name, ...)                                            \
    FMI3(Status, name)(void *o __VA_ARGS__)                               \
    {                                                                     \
        return instance_refuse(o, #name " is not supported");             \
    }
#define AND ,
NO_FUNCTION(EnterEventMode)
NO_FUNCTION(EnterStepMode)
NO_FUNCTION(EnterConfigurationMode)
NO_FUNCTION(ExitConfigurationMode)
NO_FUNCTION(EvaluateDiscreteStates)
NO_FUNCTION(UpdateDiscreteStates, AND bool *again AND bool *terminate
            AND bool *nominals AND bool *values AND bool *defined
            AND double *time_s)
NO_FUNCTION(GetNumberOfVariableDependencies, AND uint32_t reference
            AND size_t *n)
NO_FUNCTION(GetVariableDependencies, AND uint32_t reference
            AND size_t *elements AND uint32_t *independents
            AND size_t *of_independents AND int *kinds AND size_t n)
/* some importers load those of the other interfaces as well */
NO_FUNCTION(EnterContinuousTimeMode)
NO_FUNCTION(SetTime, AND double time_s)
NO_FUNCTION(SetContinuousStates, AND const double *states AND size_t n)
NO_FUNCTION(GetContinuousStates, AND double *states AND size_t n)
NO_FUNCTION(GetContinuousStateDerivatives, AND double *rates AND size_t n)
NO_FUNCTION(GetNominalsOfContinuousStates, AND double *values AND size_t n)
NO_FUNCTION(GetEventIndicators, AND double *values AND size_t n)
NO_FUNCTION(GetNumberOfEventIndicators, AND size_t *n)
NO_FUNCTION(GetNumberOfContinuousStates, AND size_t *n)
NO_FUNCTION(CompletedIntegratorStep, AND bool same AND bool *event
            AND bool *terminate)
NO_FUNCTION(ActivateModelPartition, AND uint32_t clock AND double time_s)

FMI3(void *, InstantiateModelExchange)(
    const char *name, const char *token, const char *resources, bool visible,
    bool logging, void *environment, Logger logger)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)environment, (void)logger;
    return NULL;
}

FMI3(void *, InstantiateScheduledExecution)(
    const char *name, const char *token, const char *resources, bool visible,
    bool logging, void *environment, Logger logger, void *clock_update,
    void *lock, void *unlock)
{
    (void)clock_update, (void)lock, (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible,
                                        logging, environment, logger);
}

FMI3(Status, GetFMUState)(void *o, void **saved)
{
    return instance_save(o, saved);
}

FMI3(Status, SetFMUState)(void *o, void *saved)
{
    return instance_restore(o, saved);
}

FMI3(Status, FreeFMUState)(void *o, void **saved)
{
    (void)o;
    if (saved == NULL) return FMU_OK;
    free(*saved);
    *saved = NULL;
    return FMU_OK;
}

FMI3(Status, SerializedFMUStateSize)(void *o, void *saved, size_t *size)
{
    (void)o, (void)saved;
    *size = sizeof(Memory);
    return FMU_OK;
}

FMI3(Status, SerializeFMUState)(void *o, void *saved, uint8_t *bytes,
                                size_t size)
{
    return instance_serialise(o, saved, bytes, size);
}

FMI3(Status, DeserializeFMUState)(void *o, const uint8_t *bytes, size_t size,
                                  void **saved)
{
    return instance_deserialise(o, bytes, size, saved);
}

FMI3(Status, DoStep)(void *o, double time_s, double step_s, bool no_return,
                     bool *event, bool *terminate, bool *early,
                     double *last_time_s)
{
    (void)no_return;
    const Status status = instance_do_step(o, time_s, step_s);
    *event = *terminate = *early = false;
    *last_time_s = ((Instance *)o)->m.time_s;
    return status;
}
