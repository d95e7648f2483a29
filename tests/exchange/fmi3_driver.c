#include <stdio.h>
#include <stdlib.h>
#include "fmi3Functions.h"
#include "network.h"
static void logger(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c,
                   fmi3String text) { }

/* Two instances stepped in turn; every variable read and set; states saved,
 * serialised and restored. Built with the headers of the standard. */
int main(void)
{
    fmi3Boolean event, end, early;
    fmi3Float64 last;
    fmi3Instance a[2];
    for (int i = 0; i < 2; i++) {
        a[i] = fmi3InstantiateCoSimulation("a", FMU_TOKEN, "", fmi3False, fmi3False, fmi3False, fmi3False, NULL, 0, NULL, logger, NULL);
        if (a[i] == NULL
            || fmi3EnterInitializationMode(a[i], fmi3False, 0.0, 0.0, fmi3False, 0.0) || fmi3ExitInitializationMode(a[i]))
            return 1;
    }
    for (int k = 0; k < 1000; k++)
        for (int i = 0; i < 2; i++) {
            const double t = 0.05 * k;
            unsigned r;
            double x;
            for (r = 0; r < FMU_VARIABLES; r++)
                if (fmi3GetFloat64(a[i], &r, 1, &x, 1)) return 2;
            for (r = 0; r < FMU_VARIABLES; r++) {
                x = i + 0.01 * (k % 100);
                if (FMU_VARIABLE[r].kind == VARIABLE_INPUT
                    && fmi3SetFloat64(a[i], &r, 1, &x, 1))
                    return 3;
            }
            if (fmi3DoStep(a[i], t, 0.05, fmi3True, &event, &end, &early, &last)) return 4;
        }
    printf("2000 steps\n");
    for (unsigned r = 0; r < FMU_VARIABLES; r++) {
        double x;
        if (fmi3GetFloat64(a[0], &r, 1, &x, 1)) return 8;
        if (FMU_VARIABLE[r].kind == VARIABLE_STATE) printf("%.17g\n", x);
    }
    fmi3FMUState saved = NULL, copy = NULL;
    size_t size;
    if (fmi3GetFMUState(a[0], &saved) || fmi3SerializedFMUStateSize(a[0], saved, &size)) return 5;
    fmi3Byte *bytes = malloc(size);
    if (fmi3SerializeFMUState(a[0], saved, bytes, size)
        || fmi3DeserializeFMUState(a[1], bytes, size, &copy) || fmi3SetFMUState(a[1], copy)
        || fmi3FreeFMUState(a[0], &saved) || fmi3FreeFMUState(a[1], &copy))
        return 6;
    /* another model's state is refused */
    bytes[5] ^= 1;
    if (!fmi3DeserializeFMUState(a[1], bytes, size, &copy)) return 7;
    free(bytes);
    for (int i = 0; i < 2; i++) {
        fmi3Reset(a[i]);
        fmi3FreeInstance(a[i]);
    }
    return 0;
}
