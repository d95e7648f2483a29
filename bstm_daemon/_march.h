/* A network's structure and a march over it, as its two sources share them:
 * _kernel.c checks what comes from Python, _march.c runs it. thermal/program.py
 * lays out `ints` and `floats`.
 */
#ifndef BSTM_MARCH_H
#define BSTM_MARCH_H

#include <stddef.h>
#include <stdint.h>

enum {
    COUNT_LAYOUT, COUNT_NODES, COUNT_MEMORIES, COUNT_INPUTS, COUNT_LINKS,
    COUNT_SOURCES, COUNT_FACTORS, COUNT_TABLES, COUNT_USES, COUNT_ENTRIES,
    COUNT_OPERATIONS, COUNT_PIVOTS, COUNT_FLOATS, COUNTS
};

enum {
    NODE_TABLE, NODE_INPUT, NODE_FREE, LINK_A, LINK_B, LINK_ENTRY,
    SOURCE_NODE, MEMORY_KIND, USE_START, USE_FACTOR, FACTOR_KIND, FACTOR_A,
    FACTOR_B, FACTOR_TABLE, FACTOR_STEADY, TABLE_POINTS, TABLE_OFFSET,
    PIVOT_NODE, PIVOT_ENTRY_START, PIVOT_OPERATION_START, ENTRY_ROW,
    OPERATION_LEFT, OPERATION_RIGHT, OPERATION_TARGET, SECTIONS
};

typedef struct {
    int count[COUNTS];
    const int32_t *section[SECTIONS];
} Structure;

typedef struct {
    const Structure *s;
    const double *floats;     /* [members][floats] */
    double *state;            /* [members][nodes + memories] */
    const double *inputs;     /* [steps][sets][inputs] */
    const int32_t *set_of;    /* [members] */
    double *ledger;           /* [members][links + sources] */
    double *outputs;          /* [outputs][members][state + sources] */
    ptrdiff_t members, sets, steps;
    double dt;
    int every, phase;
} March;

/* March all members. Returns -1 where memory is short. */
int bstm_march(const March *m);

#endif
