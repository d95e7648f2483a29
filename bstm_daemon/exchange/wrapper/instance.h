/* One instance of an exported model (exchange/fmu.py), whatever the version
 * of FMI. "network.h" is generated from the configuration.
 */
#ifndef BSTM_FMU_INSTANCE_H
#define BSTM_FMU_INSTANCE_H

#include "march.h"
#include "network.h"
#if FMU_HEAT
#include "sample_pass.h"
#endif

#ifdef _WIN32
#define FMU_EXPORT __declspec(dllexport)
#else
#define FMU_EXPORT __attribute__((visibility("default")))
#endif

enum { FMU_OK, FMU_WARNING, FMU_DISCARD, FMU_ERROR };

/* All that changes while it runs: what FMI saves, restores and serialises. */
typedef struct {
    char token[40];
    int64_t initialized, now_us, grid_us, warned;
    double time_s, grid_s; /* the communication point; that of the outputs */
    double input[FMU_INPUTS], tunable[FMU_TUNABLES + 1];
    double floats[FMU_FLOATS], state[FMU_STATES], ledger[FMU_LEDGERS];
    double rows[FMU_SETS * CHANNELS], vehicle[VEHICLE_CHANNELS];
#if FMU_HEAT
    SampleMemoryInts times;
    SampleMemoryFloats numbers;
    int64_t flags;
#else
    double open[CHANNELS]; /* inputs times their time in the open step [us] */
#endif
} Memory;

typedef struct Instance {
    Memory m;
    Structure structure[FMU_CORNERS];
    void *environment, *logger;
    char *name;
    void (*log)(const struct Instance *, int status, const char *text);
} Instance;

/* NULL where the token is another model's or memory is short. */
Instance *instance_new(const char *name, const char *token,
                       void *environment, void *logger,
                       void (*log)(const Instance *, int, const char *));
void instance_free(Instance *o);
void instance_reset(Instance *o);
int instance_start(Instance *o, double time_s);
int instance_do_step(Instance *o, double time_s, double step_s);
int instance_get(Instance *o, const uint32_t *references, size_t n,
                 double *values);
int instance_set(Instance *o, const uint32_t *references, size_t n,
                 const double *values);
/* A copy of the memory into *saved, which is made where it is NULL. */
int instance_save(const Instance *o, void **saved);
int instance_restore(Instance *o, const void *saved);
int instance_serialise(const Instance *o, const void *saved, void *bytes,
                       size_t size);
int instance_deserialise(const Instance *o, const void *bytes, size_t size,
                         void **saved);
/* Log what this model has no use for. */
int instance_refuse(const Instance *o, const char *what);

#endif
