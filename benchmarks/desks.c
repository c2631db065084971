/* Run the library of an FMU as a program on Windows does:
 *
 *     desks.exe LIBRARY GUID OUTPUTS INPUTS STEP STEPS < inputs.txt
 *
 * The inputs of a sample are read from a line, its outputs are written to one. Value references are
 * those of an exported FMU: outputs first, then inputs.
 */
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

#include "fmi2TypesPlatform.h"
#include "fmi2FunctionTypes.h"

#define MOST 64
#define FIND(name)                                                                               \
    fmi2##name##TYPE *name = (fmi2##name##TYPE *)(void *)GetProcAddress(library, "fmi2" #name); \
    if (!name) {                                                                                 \
        return failed("the library has no fmi2" #name);                                          \
    }
#define CALL(call)                      \
    if ((call) != fmi2OK) {             \
        return failed(#call " failed"); \
    }

static int failed(const char *message)
{
    fprintf(stderr, "%s (error %lu)\n", message, (unsigned long)GetLastError());
    return 1;
}

static void say(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                fmi2String category, fmi2String message, ...)
{
    (void)environment, (void)name, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

int main(int count, char **words)
{
    const fmi2CallbackFunctions functions = { say, calloc, free, 0, 0 };
    unsigned references[2 * MOST];
    double inputs[MOST], outputs[MOST];

    if (count != 7) {
        return failed("usage: desks.exe LIBRARY GUID OUTPUTS INPUTS STEP STEPS");
    }
    const int ny = atoi(words[3]), nu = atoi(words[4]), steps = atoi(words[6]);
    const double step = atof(words[5]);
    if (ny > MOST || nu > MOST) {
        return failed("too many signals");
    }
    for (unsigned i = 0; i < 2 * MOST; i++) {
        references[i] = i;
    }

    HMODULE library = LoadLibraryA(words[1]);
    if (!library) {
        return failed("the library cannot be loaded");
    }
    FIND(Instantiate)
    FIND(SetupExperiment)
    FIND(EnterInitializationMode)
    FIND(ExitInitializationMode)
    FIND(SetReal)
    FIND(GetReal)
    FIND(DoStep)
    FIND(Terminate)
    FIND(FreeInstance)

    fmi2Component model = Instantiate("desks", fmi2CoSimulation, words[2], "", &functions, 0, 0);
    if (!model) {
        return failed("no instance");
    }
    CALL(SetupExperiment(model, 0, 0, 0, 0, 0))
    CALL(EnterInitializationMode(model))
    CALL(ExitInitializationMode(model))
    for (int n = 0; n < steps; n++) {
        for (int i = 0; i < nu; i++) {
            if (scanf("%lf", inputs + i) != 1) {
                return failed("too few inputs");
            }
        }
        CALL(SetReal(model, references + ny, nu, inputs))
        CALL(GetReal(model, references, ny, outputs))
        CALL(DoStep(model, n * step, step, 1))
        for (int i = 0; i < ny; i++) {
            printf("%.17g%c", outputs[i], i + 1 < ny ? ' ' : '\n');
        }
    }
    CALL(Terminate(model))
    FreeInstance(model);
    return 0;
}
