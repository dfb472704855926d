/* FMI 3.0 Co-Simulation of one valve. Declarations follow the standard (FMI 3.0.2, sections 2.2 and 4.2). */

#include "model.h"
#include "unit.h"

#ifdef FMI3_FUNCTION_PREFIX
#define JOINED(prefix, name) prefix##name
#define PREFIXED(prefix, name) JOINED(prefix, name)
#define FMI(name) PREFIXED(FMI3_FUNCTION_PREFIX, fmi3##name)
#define EXPORTED
#else
#define FMI(name) fmi3##name
#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif
#endif

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*fmi3Logger)(void *, fmi3Status, const char *, const char *);
typedef void (*fmi3IntermediateUpdate)(void *environment, double time, bool set_requested, bool get_allowed,
                                       bool step_finished, bool can_return_early, bool *return_requested,
                                       double *return_time);
typedef uint32_t reference;

#define CALL(name) EXPORTED fmi3Status FMI(name)
#define LOGGER 0
#define UPDATE 1

static void report(spool_unit *unit, const char *text, bool warning)
{
    fmi3Logger logger;
    memcpy(&logger, &unit->callbacks[LOGGER], sizeof logger);
    if (logger)
        logger(unit->environment, warning ? fmi3Warning : fmi3Error, warning ? "logStatusWarning" : "logStatusError",
               text);
}

static void ask(spool_unit *unit, double time)
{
    fmi3IntermediateUpdate update;
    bool early = false;
    double when = time;
    memcpy(&update, &unit->callbacks[UPDATE], sizeof update);
    update(unit->environment, time, true, false, false, false, &early, &when);
}

EXPORTED const char *FMI(GetVersion)(void) { return "3.0"; }

EXPORTED void *FMI(InstantiateCoSimulation)(const char *name, const char *token, const char *resources, bool visible,
                                            bool logging, bool events, bool early_return, const reference required[],
                                            size_t count, void *environment, fmi3Logger logger,
                                            fmi3IntermediateUpdate update)
{
    spool_unit *unit = unit_new(name);
    (void)resources, (void)visible, (void)logging, (void)early_return;
    if (!unit) return NULL;
    unit->environment = environment;
    memcpy(&unit->callbacks[LOGGER], &logger, sizeof logger);
    memcpy(&unit->callbacks[UPDATE], &update, sizeof update);
    unit->report = report;
    for (size_t one = 0; one < count; ++one)
        if (update && required[one] == BODY_ACCELERATION) unit->ask = ask;
    if (token && !strcmp(token, TOKEN) && !events) return unit;
    unit_say(unit, events ? "the model has no event mode" : "instantiationToken is not that of this model");
    unit_free(unit);
    return NULL;
}

EXPORTED void *FMI(InstantiateModelExchange)(const char *name, const char *token, const char *resources, bool visible,
                                             bool logging, void *environment, fmi3Logger logger)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (logger) logger(environment, fmi3Error, "logStatusError", "only Co-Simulation is offered");
    return NULL;
}

EXPORTED void *FMI(InstantiateScheduledExecution)(const char *name, const char *token, const char *resources,
                                                  bool visible, bool logging, void *environment, fmi3Logger logger,
                                                  void (*clock)(void *), void (*lock)(void), void (*unlock)(void))
{
    (void)clock, (void)lock, (void)unlock;
    return FMI(InstantiateModelExchange)(name, token, resources, visible, logging, environment, logger);
}

EXPORTED void FMI(FreeInstance)(void *unit) { unit_free(unit); }

CALL(SetDebugLogging)(spool_unit *unit, bool on, size_t count, const char *const categories[])
{
    (void)unit, (void)on, (void)count, (void)categories; /* errors and warnings are always said, nothing else is */
    return fmi3OK;
}

CALL(EnterInitializationMode)(spool_unit *unit, bool tolerant, double tolerance, double start, bool stops, double stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    unit->state.time = start;
    unit->started = true;
    unit->computed = false;
    return fmi3OK;
}

CALL(ExitInitializationMode)(spool_unit *unit) { return unit ? fmi3OK : fmi3Error; }
CALL(EnterStepMode)(spool_unit *unit) { return unit ? fmi3OK : fmi3Error; }
CALL(Terminate)(spool_unit *unit) { return unit ? fmi3OK : fmi3Error; }

CALL(Reset)(spool_unit *unit)
{
    unit_reset(unit);
    return fmi3OK;
}

static fmi3Status nothing(spool_unit *unit, size_t count, const char *text)
{
    if (!count) return fmi3OK;
    unit_say(unit, "%s", text);
    return fmi3Error;
}

CALL(GetFloat64)(spool_unit *unit, const reference which[], size_t count, double values[], size_t size)
{
    if (size != count) return nothing(unit, 1, "fmi3GetFloat64: each variable has one value");
    for (size_t one = 0; one < count; ++one)
        if (!unit_get(unit, which[one], &values[one])) return fmi3Error;
    return fmi3OK;
}

CALL(SetFloat64)(spool_unit *unit, const reference which[], size_t count, const double values[], size_t size)
{
    if (size != count) return nothing(unit, 1, "fmi3SetFloat64: each variable has one value");
    for (size_t one = 0; one < count; ++one)
        if (!unit_set(unit, which[one], values[one])) return fmi3Error;
    return fmi3OK;
}

CALL(GetBoolean)(spool_unit *unit, const reference which[], size_t count, bool values[], size_t size)
{
    if (size != count) return nothing(unit, 1, "fmi3GetBoolean: each variable has one value");
    for (size_t one = 0; one < count; ++one) {
        if (which[one] != STICKING) return nothing(unit, 1, "fmi3GetBoolean: the only one is sticking");
        values[one] = unit_outputs(unit)->stuck;
    }
    return fmi3OK;
}

#define NO_VARIABLES(name, type)                                                                     \
    CALL(name)(spool_unit *unit, const reference which[], size_t count, type values[], size_t size)  \
    {                                                                                                \
        (void)which, (void)values, (void)size;                                                       \
        return nothing(unit, count, "fmi3" #name ": the model has no such variable");                \
    }
#define NO_NUMBERS(name, type) NO_VARIABLES(Get##name, type) NO_VARIABLES(Set##name, const type)
NO_NUMBERS(Float32, float)
NO_NUMBERS(Int8, int8_t)
NO_NUMBERS(UInt8, uint8_t)
NO_NUMBERS(Int16, int16_t)
NO_NUMBERS(UInt16, uint16_t)
NO_NUMBERS(Int32, int32_t)
NO_NUMBERS(UInt32, uint32_t)
NO_NUMBERS(Int64, int64_t)
NO_NUMBERS(UInt64, uint64_t)
NO_VARIABLES(SetBoolean, const bool)
NO_VARIABLES(GetString, const char *)
NO_VARIABLES(SetString, const char *const)

CALL(GetBinary)(spool_unit *unit, const reference which[], size_t count, size_t sizes[], const uint8_t *values[],
                size_t size)
{
    (void)which, (void)sizes, (void)values, (void)size;
    return nothing(unit, count, "fmi3GetBinary: the model has no such variable");
}

CALL(SetBinary)(spool_unit *unit, const reference which[], size_t count, const size_t sizes[],
                const uint8_t *const values[], size_t size)
{
    (void)which, (void)sizes, (void)values, (void)size;
    return nothing(unit, count, "fmi3SetBinary: the model has no such variable");
}

CALL(GetFMUState)(spool_unit *unit, void **state)
{
    if (!*state) *state = malloc(sizeof(spool_state));
    if (!*state) return fmi3Error;
    memcpy(*state, &unit->state, sizeof(spool_state));
    return fmi3OK;
}

CALL(SetFMUState)(spool_unit *unit, void *state)
{
    if (!state) return fmi3Error;
    memcpy(&unit->state, state, sizeof(spool_state));
    unit_changed(unit);
    return fmi3OK;
}

CALL(FreeFMUState)(spool_unit *unit, void **state)
{
    (void)unit;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

CALL(SerializedFMUStateSize)(spool_unit *unit, void *state, size_t *size)
{
    (void)unit, (void)state;
    *size = SERIALIZED;
    return fmi3OK;
}

CALL(SerializeFMUState)(spool_unit *unit, void *state, uint8_t bytes[], size_t size)
{
    return unit_serialize(unit, state, bytes, size) ? fmi3OK : fmi3Error;
}

CALL(DeserializeFMUState)(spool_unit *unit, const uint8_t bytes[], size_t size, void **state)
{
    return unit_deserialize(unit, bytes, size, state) ? fmi3OK : fmi3Error;
}

CALL(GetOutputDerivatives)(spool_unit *unit, const reference which[], size_t count, const int32_t orders[],
                           double values[], size_t size)
{
    (void)which, (void)orders, (void)values, (void)size;
    return nothing(unit, count, "fmi3GetOutputDerivatives is not offered");
}

CALL(DoStep)(spool_unit *unit, double time, double length, bool keeps, bool *event, bool *terminate, bool *early,
             double *reached)
{
    bool good = unit_step(unit, time, length);
    (void)keeps;
    *event = *terminate = *early = false;
    *reached = good ? time + length : time;
    return good ? fmi3OK : fmi3Error;
}

/* What Co-Simulation without events, clocks, arrays and derivatives never calls. The caller removes its
 * arguments from the stack, so only the first one is read. */
#define NOT_OFFERED(name)                                                                            \
    CALL(name)(spool_unit *unit, ...) { return nothing(unit, 1, "fmi3" #name " is not offered"); }
NOT_OFFERED(EnterEventMode)
NOT_OFFERED(GetClock)
NOT_OFFERED(SetClock)
NOT_OFFERED(GetNumberOfVariableDependencies)
NOT_OFFERED(GetVariableDependencies)
NOT_OFFERED(GetDirectionalDerivative)
NOT_OFFERED(GetAdjointDerivative)
NOT_OFFERED(EnterConfigurationMode)
NOT_OFFERED(ExitConfigurationMode)
NOT_OFFERED(GetIntervalDecimal)
NOT_OFFERED(GetIntervalFraction)
NOT_OFFERED(GetShiftDecimal)
NOT_OFFERED(GetShiftFraction)
NOT_OFFERED(SetIntervalDecimal)
NOT_OFFERED(SetIntervalFraction)
NOT_OFFERED(SetShiftDecimal)
NOT_OFFERED(SetShiftFraction)
NOT_OFFERED(EvaluateDiscreteStates)
NOT_OFFERED(UpdateDiscreteStates)
NOT_OFFERED(EnterContinuousTimeMode)
NOT_OFFERED(CompletedIntegratorStep)
NOT_OFFERED(SetTime)
NOT_OFFERED(SetContinuousStates)
NOT_OFFERED(GetContinuousStateDerivatives)
NOT_OFFERED(GetEventIndicators)
NOT_OFFERED(GetContinuousStates)
NOT_OFFERED(GetNominalsOfContinuousStates)
NOT_OFFERED(GetNumberOfEventIndicators)
NOT_OFFERED(GetNumberOfContinuousStates)
NOT_OFFERED(ActivateModelPartition)
