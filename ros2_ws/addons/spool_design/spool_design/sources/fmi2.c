/* FMI 2.0 Co-Simulation of one valve. Declarations follow the standard (FMI 2.0.4, section 2.1 and 4.2). */

#include "model.h"
#include "unit.h"

#ifdef FMI2_FUNCTION_PREFIX
#define JOINED(prefix, name) prefix##name
#define PREFIXED(prefix, name) JOINED(prefix, name)
#define FMI(name) PREFIXED(FMI2_FUNCTION_PREFIX, fmi2##name)
#define EXPORTED
#else
#define FMI(name) fmi2##name
#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif
#endif

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef void (*fmi2Logger)(void *, const char *, fmi2Status, const char *, const char *, ...);
typedef struct {
    fmi2Logger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;
typedef unsigned int reference;

#define CALL(name) EXPORTED fmi2Status FMI(name)

static void report(spool_unit *unit, const char *text, bool warning)
{
    const fmi2CallbackFunctions *given = unit->callbacks[0];
    if (given && given->logger)
        given->logger(given->componentEnvironment, unit->name, warning ? fmi2Warning : fmi2Error,
                      warning ? "logStatusWarning" : "logStatusError", "%s", text);
}

EXPORTED const char *FMI(GetTypesPlatform)(void) { return "default"; }
EXPORTED const char *FMI(GetVersion)(void) { return "2.0"; }

EXPORTED void *FMI(Instantiate)(const char *name, fmi2Type type, const char *guid, const char *resources,
                                const fmi2CallbackFunctions *functions, int visible, int logging)
{
    spool_unit *unit = unit_new(name);
    (void)resources, (void)visible, (void)logging;
    if (!unit) return NULL;
    unit->callbacks[0] = (void *)functions;
    unit->report = report;
    if (type == fmi2CoSimulation && guid && !strcmp(guid, TOKEN)) return unit;
    unit_say(unit, type == fmi2CoSimulation ? "guid is not that of this model" : "only Co-Simulation is offered");
    unit_free(unit);
    return NULL;
}

EXPORTED void FMI(FreeInstance)(void *unit) { unit_free(unit); }

CALL(SetDebugLogging)(spool_unit *unit, int on, size_t count, const char *const categories[])
{
    (void)unit, (void)on, (void)count, (void)categories; /* errors and warnings are always said, nothing else is */
    return fmi2OK;
}

CALL(SetupExperiment)(spool_unit *unit, int tolerant, double tolerance, double start, int stops, double stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    unit->state.time = start;
    unit->started = true;
    unit->computed = false;
    return fmi2OK;
}

CALL(EnterInitializationMode)(spool_unit *unit) { return unit ? fmi2OK : fmi2Error; }
CALL(ExitInitializationMode)(spool_unit *unit) { return unit ? fmi2OK : fmi2Error; }

CALL(Terminate)(spool_unit *unit) { return unit ? fmi2OK : fmi2Error; }

CALL(Reset)(spool_unit *unit)
{
    unit_reset(unit);
    return fmi2OK;
}

CALL(GetReal)(spool_unit *unit, const reference which[], size_t count, double values[])
{
    for (size_t one = 0; one < count; ++one)
        if (!unit_get(unit, which[one], &values[one])) return fmi2Error;
    return fmi2OK;
}

CALL(SetReal)(spool_unit *unit, const reference which[], size_t count, const double values[])
{
    for (size_t one = 0; one < count; ++one)
        if (!unit_set(unit, which[one], values[one])) return fmi2Error;
    return fmi2OK;
}

CALL(GetBoolean)(spool_unit *unit, const reference which[], size_t count, int values[])
{
    for (size_t one = 0; one < count; ++one) {
        if (which[one] != STICKING) {
            unit_say(unit, "value reference %u: no such truth value", which[one]);
            return fmi2Error;
        }
        values[one] = unit_outputs(unit)->stuck;
    }
    return fmi2OK;
}

static fmi2Status nothing(spool_unit *unit, size_t count, const char *text)
{
    if (!count) return fmi2OK;
    unit_say(unit, "%s", text);
    return fmi2Error;
}

#define NO_VARIABLES(name, type)                                                                     \
    CALL(name)(spool_unit *unit, const reference which[], size_t count, type values[])               \
    {                                                                                                \
        (void)which, (void)values;                                                                   \
        return nothing(unit, count, "fmi2" #name ": the model has no such variable");                \
    }
NO_VARIABLES(GetInteger, int)
NO_VARIABLES(GetString, const char *)
NO_VARIABLES(SetInteger, const int)
NO_VARIABLES(SetBoolean, const int)
NO_VARIABLES(SetString, const char *const)

CALL(GetFMUstate)(spool_unit *unit, void **state)
{
    if (!*state) *state = malloc(sizeof(spool_state));
    if (!*state) return fmi2Error;
    memcpy(*state, &unit->state, sizeof(spool_state));
    return fmi2OK;
}

CALL(SetFMUstate)(spool_unit *unit, void *state)
{
    if (!state) return fmi2Error;
    memcpy(&unit->state, state, sizeof(spool_state));
    unit_changed(unit);
    return fmi2OK;
}

CALL(FreeFMUstate)(spool_unit *unit, void **state)
{
    (void)unit;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

CALL(SerializedFMUstateSize)(spool_unit *unit, void *state, size_t *size)
{
    (void)unit, (void)state;
    *size = SERIALIZED;
    return fmi2OK;
}

CALL(SerializeFMUstate)(spool_unit *unit, void *state, char bytes[], size_t size)
{
    return unit_serialize(unit, state, bytes, size) ? fmi2OK : fmi2Error;
}

CALL(DeSerializeFMUstate)(spool_unit *unit, const char bytes[], size_t size, void **state)
{
    return unit_deserialize(unit, bytes, size, state) ? fmi2OK : fmi2Error;
}

CALL(GetDirectionalDerivative)(spool_unit *unit, const reference unknown[], size_t unknowns, const reference known[],
                               size_t knowns, const double seed[], double found[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)found;
    return nothing(unit, 1, "fmi2GetDirectionalDerivative is not offered");
}

CALL(SetRealInputDerivatives)(spool_unit *unit, const reference which[], size_t count, const int order[],
                              const double values[])
{
    for (size_t one = 0; one < count; ++one) {
        if (OIL_POINTS && which[one] == OIL_TEMPERATURE) continue; /* slow: held within a step */
        if (which[one] != BODY_ACCELERATION || order[one] < 1 || order[one] > 2)
            return nothing(unit, 1, "body_acceleration has derivatives of order 1 and 2, other numbers have none");
        unit->state.body[order[one]] = values[one];
    }
    return fmi2OK;
}

CALL(GetRealOutputDerivatives)(spool_unit *unit, const reference which[], size_t count, const int order[],
                               double values[])
{
    (void)which, (void)order, (void)values;
    return nothing(unit, count, "fmi2GetRealOutputDerivatives is not offered");
}

CALL(DoStep)(spool_unit *unit, double time, double length, int keeps)
{
    (void)keeps;
    return unit_step(unit, time, length) ? fmi2OK : fmi2Error;
}

#define NEVER_PENDING(name, type)                                                                    \
    CALL(name)(spool_unit *unit, int kind, type value)                                               \
    {                                                                                                \
        (void)unit, (void)kind, (void)value;                                                         \
        return fmi2Discard;                                                                          \
    }
NEVER_PENDING(GetStatus, fmi2Status *)
NEVER_PENDING(GetRealStatus, double *)
NEVER_PENDING(GetIntegerStatus, int *)
NEVER_PENDING(GetBooleanStatus, int *)
NEVER_PENDING(GetStringStatus, const char **)

CALL(CancelStep)(spool_unit *unit) { return nothing(unit, 1, "no step is pending"); }
