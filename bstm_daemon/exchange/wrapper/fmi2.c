/* FMI 2.0 for co-simulation: the types and functions of its standard headers,
 * as far as this model uses them.
 */
#include <stdlib.h>

#include "instance.h"

typedef int Status;
typedef void (*Logger)(void *environment, const char *name, Status status,
                       const char *category, const char *text, ...);
typedef struct {
    Logger logger;
    void *allocate, *free, *step_finished, *environment;
} Callbacks;

#define FMI2(type, name) FMU_EXPORT type fmi2##name

static void write_log(const Instance *o, int status, const char *text)
{
    const Logger logger = (Logger)o->logger;
    if (logger != NULL)
        logger(o->environment, o->name, status,
               status == FMU_WARNING ? "logStatusWarning" : "logStatusError",
               "%s", text);
}

FMI2(const char *, GetTypesPlatform)(void) { return "default"; }
FMI2(const char *, GetVersion)(void) { return "2.0"; }

FMI2(void *, Instantiate)(const char *name, int kind, const char *token,
                          const char *resources, const Callbacks *callbacks,
                          int visible, int logging)
{
    (void)resources, (void)visible, (void)logging;
    const int co_simulation = 1;
    if (kind != co_simulation || callbacks == NULL) return NULL;
    return instance_new(name, token, callbacks->environment,
                        (void *)callbacks->logger, write_log);
}

FMI2(void, FreeInstance)(void *o) { instance_free(o); }

FMI2(Status, SetDebugLogging)(void *o, int on, size_t n,
                              const char *const *categories)
{
    (void)o, (void)on, (void)n, (void)categories;
    return FMU_OK;
}

FMI2(Status, SetupExperiment)(void *o, int with_tolerance, double tolerance,
                              double start_s, int with_stop, double stop_s)
{
    (void)with_tolerance, (void)tolerance, (void)with_stop, (void)stop_s;
    return instance_start(o, start_s);
}

FMI2(Status, EnterInitializationMode)(void *o) { (void)o; return FMU_OK; }
FMI2(Status, ExitInitializationMode)(void *o) { (void)o; return FMU_OK; }
FMI2(Status, Terminate)(void *o) { (void)o; return FMU_OK; }
FMI2(Status, Reset)(void *o) { instance_reset(o); return FMU_OK; }

FMI2(Status, GetReal)(void *o, const uint32_t *references, size_t n,
                      double *values)
{
    return instance_get(o, references, n, values);
}

FMI2(Status, SetReal)(void *o, const uint32_t *references, size_t n,
                      const double *values)
{
    return instance_set(o, references, n, values);
}

#define NO_ACCESS(name, pointer)                                          \
    FMI2(Status, name)(void *o, const uint32_t *references, size_t n,     \
                       pointer values)                                    \
    {                                                                     \
        (void)references, (void)values;                                   \
        return n == 0 ? FMU_OK                                            \
                      : instance_refuse(o, #name ": all variables are "   \
                                                 "real numbers");         \
    }
NO_ACCESS(GetInteger, int *)
NO_ACCESS(GetBoolean, int *)
NO_ACCESS(GetString, const char **)
NO_ACCESS(SetInteger, const int *)
NO_ACCESS(SetBoolean, const int *)
NO_ACCESS(SetString, const char *const *)

FMI2(Status, GetFMUstate)(void *o, void **saved)
{
    return instance_save(o, saved);
}

FMI2(Status, SetFMUstate)(void *o, void *saved)
{
    return instance_restore(o, saved);
}

FMI2(Status, FreeFMUstate)(void *o, void **saved)
{
    (void)o;
    if (saved == NULL) return FMU_OK;
    free(*saved);
    *saved = NULL;
    return FMU_OK;
}

FMI2(Status, SerializedFMUstateSize)(void *o, void *saved, size_t *size)
{
    (void)o, (void)saved;
    *size = sizeof(Memory);
    return FMU_OK;
}

FMI2(Status, SerializeFMUstate)(void *o, void *saved, char *bytes,
                                size_t size)
{
    return instance_serialise(o, saved, bytes, size);
}

FMI2(Status, DeSerializeFMUstate)(void *o, const char *bytes, size_t size,
                                  void **saved)
{
    return instance_deserialise(o, bytes, size, saved);
}

FMI2(Status, GetDirectionalDerivative)(
    void *o, const uint32_t *unknowns, size_t n, const uint32_t *knowns,
    size_t m, const double *seed, double *values)
{
    (void)unknowns, (void)n, (void)knowns, (void)m, (void)seed, (void)values;
    return instance_refuse(o, "there are no directional derivatives");
}

FMI2(Status, SetRealInputDerivatives)(void *o, const uint32_t *references,
                                      size_t n, const int *order,
                                      const double *values)
{
    (void)references, (void)n, (void)order, (void)values;
    return instance_refuse(o, "inputs are held");
}

FMI2(Status, GetRealOutputDerivatives)(void *o, const uint32_t *references,
                                       size_t n, const int *order,
                                       double *values)
{
    (void)references, (void)n, (void)order, (void)values;
    return instance_refuse(o, "there are no output derivatives");
}

FMI2(Status, DoStep)(void *o, double time_s, double step_s, int no_return)
{
    (void)no_return;
    return instance_do_step(o, time_s, step_s);
}

FMI2(Status, CancelStep)(void *o)
{
    return instance_refuse(o, "no step is pending");
}

#define NO_STATUS(name, pointer)                                          \
    FMI2(Status, name)(void *o, int kind, pointer value)                  \
    {                                                                     \
        (void)o, (void)kind, (void)value;                                 \
        return FMU_DISCARD;                                               \
    }
NO_STATUS(GetStatus, Status *)
NO_STATUS(GetIntegerStatus, int *)
NO_STATUS(GetBooleanStatus, int *)
NO_STATUS(GetStringStatus, const char **)

FMI2(Status, GetRealStatus)(void *o, int kind, double *value)
{
    const int last_successful_time = 2;
    if (kind != last_successful_time) return FMU_DISCARD;
    *value = ((Instance *)o)->m.time_s;
    return FMU_OK;
}
