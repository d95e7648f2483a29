#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include "fmi2Functions.h"
#include "network.h"
static void logger(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s,
                   fmi2String c, fmi2String text, ...) { }

/* Two instances stepped in turn; every variable read and set; states saved,
 * serialised and restored. Built with the headers of the standard. */
int main(void)
{
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2Component a[2];
    for (int i = 0; i < 2; i++) {
        a[i] = fmi2Instantiate("a", fmi2CoSimulation, FMU_TOKEN, "", &callbacks, fmi2False, fmi2False);
        if (a[i] == NULL
            || fmi2SetupExperiment(a[i], 0, 0.0, 0.0, 0, 0.0) || fmi2EnterInitializationMode(a[i]) || fmi2ExitInitializationMode(a[i]))
            return 1;
    }
    for (int k = 0; k < 1000; k++)
        for (int i = 0; i < 2; i++) {
            const double t = 0.05 * k;
            unsigned r;
            double x;
            for (r = 0; r < FMU_VARIABLES; r++)
                if (fmi2GetReal(a[i], &r, 1, &x)) return 2;
            for (r = 0; r < FMU_VARIABLES; r++) {
                x = i + 0.01 * (k % 100);
                if (FMU_VARIABLE[r].kind == VARIABLE_INPUT
                    && fmi2SetReal(a[i], &r, 1, &x))
                    return 3;
            }
            if (fmi2DoStep(a[i], t, 0.05, fmi2True)) return 4;
        }
    printf("2000 steps\n");
    for (unsigned r = 0; r < FMU_VARIABLES; r++) {
        double x;
        if (fmi2GetReal(a[0], &r, 1, &x)) return 8;
        if (FMU_VARIABLE[r].kind == VARIABLE_STATE) printf("%.17g\n", x);
    }
    fmi2FMUstate saved = NULL, copy = NULL;
    size_t size;
    if (fmi2GetFMUstate(a[0], &saved) || fmi2SerializedFMUstateSize(a[0], saved, &size)) return 5;
    fmi2Byte *bytes = malloc(size);
    if (fmi2SerializeFMUstate(a[0], saved, bytes, size)
        || fmi2DeSerializeFMUstate(a[1], bytes, size, &copy) || fmi2SetFMUstate(a[1], copy)
        || fmi2FreeFMUstate(a[0], &saved) || fmi2FreeFMUstate(a[1], &copy))
        return 6;
    /* another model's state is refused */
    bytes[5] ^= 1;
    if (!fmi2DeSerializeFMUstate(a[1], bytes, size, &copy)) return 7;
    free(bytes);
    for (int i = 0; i < 2; i++) {
        fmi2Reset(a[i]);
        fmi2FreeInstance(a[i]);
    }
    return 0;
}
