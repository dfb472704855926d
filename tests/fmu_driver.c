/* Runs an FMU without Python: LIBRARY VERSION TOKEN FORCING STEP COUNT SHARES [REFERENCE VALUE]...
 *
 * FORCING holds the body acceleration at half internal steps of STEP s; COUNT communication steps of SHARES
 * internal ones each. Prints position, velocity, both accelerations, friction and sticking at each one's start as
 * doubles. FMI 3 asks for the forcing within a step; FMI 2 is given the parabola of the communication step. */

#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double *forcing, half;
static void *unit, *library;
static int (*set3)(void *, const uint32_t *, size_t, const double *, size_t);
static const uint32_t body = 1;

static void *named(const char *name)
{
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "no function %s\n", name);
        exit(3);
    }
    return found;
}

static void say2(void *e, const char *name, int status, const char *category, const char *format, ...)
{
    va_list given;
    va_start(given, format);
    vfprintf(stderr, format, given);
    va_end(given);
}

static void say3(void *e, int status, const char *category, const char *text) { fputs(text, stderr); }

static void update(void *e, double time, bool set, bool get, bool finished, bool early, bool *back, double *when)
{
    set3(unit, &body, 1, &forcing[lround(time / half)], 1);
}

#define CHECK(call) if ((call) != 0) { fprintf(stderr, " [%s]\n", #call); return 4; }

int main(int count, char **words)
{
    int version = atoi(words[2]), steps = atoi(words[6]), shares = atoi(words[7]);
    static const uint32_t reals[] = {10, 11, 12, 13, 14}, sticking = 15;
    static const int orders[] = {1, 2};
    static const uint32_t bodies[] = {1, 1};
    FILE *file = fopen(words[4], "rb");
    size_t points = 2 * (size_t)steps * shares + 1;
    double *rows = malloc(sizeof(double) * 6 * steps), length = atof(words[5]) * shares;
    struct timespec begin, end;
    half = 0.5 * atof(words[5]);
    forcing = malloc(sizeof(double) * points);
    if (!file || fread(forcing, sizeof(double), points, file) != points) return 2;
    library = dlopen(words[1], RTLD_NOW);
    if (!library) {
        fputs(dlerror(), stderr);
        return 2;
    }
    if (version == 3) {
        void *(*make)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t,
                      void *, void *, void *) = named("fmi3InstantiateCoSimulation");
        int (*enter)(void *, bool, double, double, bool, double) = named("fmi3EnterInitializationMode");
        int (*leave)(void *) = named("fmi3ExitInitializationMode");
        int (*get)(void *, const uint32_t *, size_t, double *, size_t) = named("fmi3GetFloat64");
        int (*truth)(void *, const uint32_t *, size_t, bool *, size_t) = named("fmi3GetBoolean");
        int (*step)(void *, double, double, bool, bool *, bool *, bool *, double *) = named("fmi3DoStep");
        bool flags[3], stuck;
        double reached;
        set3 = named("fmi3SetFloat64");
        unit = make("one", words[3], "", false, true, false, false, &body, 1, NULL, say3, update);
        if (!unit) return 4;
        CHECK(enter(unit, false, 0.0, 0.0, false, 0.0))
        for (int word = 8; word + 1 < count; word += 2) {
            uint32_t which = atoi(words[word]);
            double value = atof(words[word + 1]);
            CHECK(set3(unit, &which, 1, &value, 1))
        }
        CHECK(set3(unit, &body, 1, forcing, 1))
        CHECK(leave(unit))
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
        for (int number = 0; number < steps; ++number) {
            CHECK(get(unit, reals, 5, rows + 6 * number, 5))
            CHECK(truth(unit, &sticking, 1, &stuck, 1))
            rows[6 * number + 5] = stuck;
            CHECK(step(unit, number * length, length, true, flags, flags + 1, flags + 2, &reached))
        }
    } else {
        struct {
            void *logger, *allocate, *release, *finished, *environment;
        } callbacks = {say2, NULL, NULL, NULL, NULL};
        void *(*make)(const char *, int, const char *, const char *, void *, int, int) = named("fmi2Instantiate");
        int (*setup)(void *, int, double, double, int, double) = named("fmi2SetupExperiment");
        int (*enter)(void *) = named("fmi2EnterInitializationMode"), (*leave)(void *) = named("fmi2ExitInitializationMode");
        int (*get)(void *, const uint32_t *, size_t, double *) = named("fmi2GetReal");
        int (*set)(void *, const uint32_t *, size_t, const double *) = named("fmi2SetReal");
        int (*truth)(void *, const uint32_t *, size_t, int *) = named("fmi2GetBoolean");
        int (*bend)(void *, const uint32_t *, size_t, const int *, const double *) = named("fmi2SetRealInputDerivatives");
        int (*step)(void *, double, double, int) = named("fmi2DoStep");
        int stuck;
        unit = make("one", 1, words[3], "", &callbacks, 0, 1);
        if (!unit) return 4;
        CHECK(setup(unit, 0, 0.0, 0.0, 0, 0.0))
        CHECK(enter(unit))
        for (int word = 8; word + 1 < count; word += 2) {
            uint32_t which = atoi(words[word]);
            double value = atof(words[word + 1]);
            CHECK(set(unit, &which, 1, &value))
        }
        CHECK(leave(unit))
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
        for (int number = 0; number < steps; ++number) {
            const double *at = forcing + 2 * (size_t)number * shares;
            double a0 = at[0], am = at[shares], a1 = at[2 * shares];
            double slopes[] = {(-3.0 * a0 + 4.0 * am - a1) / length, 4.0 * (a0 - 2.0 * am + a1) / (length * length)};
            CHECK(set(unit, &body, 1, at))
            CHECK(bend(unit, bodies, 2, orders, slopes))
            CHECK(get(unit, reals, 5, rows + 6 * number))
            CHECK(truth(unit, &sticking, 1, &stuck))
            rows[6 * number + 5] = stuck;
            CHECK(step(unit, number * length, length, 1))
        }
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
    fprintf(stderr, "%.9f", end.tv_sec - begin.tv_sec + 1e-9 * (end.tv_nsec - begin.tv_nsec));
    fwrite(rows, sizeof(double), 6 * (size_t)steps, stdout);
    return 0;
}
