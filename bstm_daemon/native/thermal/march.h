/* A network's structure and a march over it, as its two sources share them:
 * python/kernel.c binds it to Python, march.c checks and runs it.
 * model/thermal/program.py lays out `ints` and `floats`.
 */
#ifndef BSTM_MARCH_H
#define BSTM_MARCH_H

#include <stddef.h>
#include <stdint.h>

#include "generated.h"

typedef struct {
    int count[COUNTS];
    const int32_t *section[SECTIONS];
} Structure;

typedef struct {
    const Structure *s;
    const double *floats;     /* [members][floats] */
    double *state;            /* [members][nodes + memories] */
    const double *inputs;     /* [rows][sets][inputs] */
    const int32_t *set_of;    /* [members] */
    double *ledger;           /* [members][links + sources], or NULL */
    double *outputs;          /* [outputs][members][columns] */
    const double *dt;         /* [durations] of the steps */
    /* rows and durations are one for all steps, or one for each */
    ptrdiff_t members, sets, steps, rows, durations;
    /* of the state and the sources that are put out */
    ptrdiff_t column, columns;
    int every, phase;
} March;

/* Whether low <= values[i] < high for all n. */
int bstm_within(const int32_t *values, int n, int low, int high);

/* Parse and check `ints`, so that no array can make the step read outside.
 * Returns NULL or what is wrong. */
const char *bstm_parse(Structure *s, const int32_t *ints, ptrdiff_t length);

/* March all members. Returns -1 where memory is short. */
int bstm_march(const March *m);

#endif
