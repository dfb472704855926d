/* One valve in a vibrating body: state, inputs, outputs and step, the same for each version of FMI.
 *
 * model.h before this file holds the laws, the time step and the tables of one model. */

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    TIME = 0, BODY_ACCELERATION = 1, OIL_TEMPERATURE = 2,
    SPOOL_POSITION = 10, SPOOL_VELOCITY, SPOOL_ACCELERATION, SPOOL_ACCELERATION_ABSOLUTE, FRICTION_FORCE, STICKING,
    INTERNAL_STEP = 20, FIRST_PARAMETER = 100
};

/* Steps of one communication step beyond which its length is wrong: 1000 s at 10 us. */
#define MOST_STEPS 1e8

/* Change of a held acceleration from one step to the next, over its rms, that most steps may have: half of it, 1 %, is
 * the error of a sine that is late by half a step. Its rms is known once it has turned so often. */
#define MUCH 0.02
#define TURNS 5.0

/* Plain numbers only: a copy of it is the whole state. */
typedef struct {
    double time, z, v, s;
    double last, change; /* m/s^2, acceleration at the start of the step before, and its change then */
    double power, jumps; /* sums of the squares of held accelerations and of their changes */
    double held, moved;  /* steps with a held acceleration, below 0 once that was said; those with much change */
    double turns;        /* how often the acceleration turned round */
    spool_memory x;
    double body[3]; /* acceleration and its derivatives with respect to time at the start of the next step */
    double oil;
    double step; /* s, longest internal one */
    double values[PARAMETER_COUNT];
} spool_state;

typedef struct {
    double z, v, relative, absolute, friction;
    bool stuck;
} spool_outputs;

typedef struct spool_unit spool_unit;
struct spool_unit {
    spool_state state;
    void *environment;
    void (*report)(spool_unit *unit, const char *text, bool warning);
    /* Asks for the body's acceleration at a time within a step; NULL where the polynomial in body[] holds. */
    void (*ask)(spool_unit *unit, double time);
    void *callbacks[2];
    char *name;
    double q[PARAMETER_COUNT]; /* parameters at the temperature of the oil */
    bool computed;             /* outputs are those of the state */
    bool started;              /* time is where the master is */
    spool_outputs outputs;
};

static void unit_tell(spool_unit *unit, bool warning, const char *format, va_list given)
{
    char text[400];
    vsnprintf(text, sizeof text, format, given);
    if (unit->report) unit->report(unit, text, warning);
}

static void unit_say(spool_unit *unit, const char *format, ...)
{
    va_list given;
    va_start(given, format);
    unit_tell(unit, false, format, given);
    va_end(given);
}

static void unit_warn(spool_unit *unit, const char *format, ...)
{
    va_list given;
    va_start(given, format);
    unit_tell(unit, true, format, given);
    va_end(given);
}

/* FNV-1a over the bytes of a state. */
static uint64_t unit_checksum(const void *state)
{
    const unsigned char *bytes = state;
    uint64_t sum = 14695981039346656037u;
    for (size_t one = 0; one < sizeof(spool_state); ++one) sum = (sum ^ bytes[one]) * 1099511628211u;
    return sum;
}

/* A serialized state: its bytes, then their checksum. */
#define SERIALIZED (sizeof(spool_state) + sizeof(uint64_t))

static bool unit_serialize(spool_unit *unit, const void *state, void *bytes, size_t size)
{
    uint64_t sum = unit_checksum(state);
    if (size < SERIALIZED) {
        unit_say(unit, "a serialized state needs %u bytes", (unsigned)SERIALIZED);
        return false;
    }
    memcpy(bytes, state, sizeof(spool_state));
    memcpy((char *)bytes + sizeof(spool_state), &sum, sizeof sum);
    return true;
}

static bool unit_deserialize(spool_unit *unit, const void *bytes, size_t size, void **state)
{
    uint64_t sum = 0;
    if (size == SERIALIZED) memcpy(&sum, (const char *)bytes + sizeof(spool_state), sizeof sum);
    if (size != SERIALIZED || sum != unit_checksum(bytes)) {
        unit_say(unit, size == SERIALIZED ? "the serialized state is damaged" : "bytes of another model");
        return false;
    }
    if (!*state) *state = malloc(sizeof(spool_state));
    if (!*state) return false;
    memcpy(*state, bytes, sizeof(spool_state));
    return true;
}

/* Count how much a held acceleration moves from step to step, and say once that the steps are too long. */
static void unit_watch(spool_unit *unit, double length)
{
    spool_state *m = &unit->state;
    double a = m->body[0], change = a - m->last, ratio;
    bool given = unit->ask || m->body[1] != 0.0 || m->body[2] != 0.0;
    m->last = a;
    if (given || m->held < 0.0) return;
    m->held += 1.0;
    m->power += a * a;
    if (m->held == 1.0) return;
    m->jumps += change * change;
    if (change * m->change < 0.0) m->turns += 1.0;
    m->change = change;
    if (change * change * m->held > MUCH * MUCH * m->power) m->moved += 1.0;
    if (m->turns < TURNS || 2.0 * m->moved < m->held) return;
    ratio = sqrt(m->jumps / m->power);
    unit_warn(unit,
              "body_acceleration is held over steps of %g s and moves by %.0f %% of its rms in each: the motion is wrong "
              "by about %.0f %%; use steps of %.1g s, or pass its course within a step",
              length, 100.0 * ratio, 50.0 * ratio, length * spool_min(0.5, MUCH / ratio));
    m->held = -1.0;
}

/* Take over what was set; beyond the ends of the oil's table that of the end holds. */
static void unit_changed(spool_unit *unit)
{
    const spool_state *m = &unit->state;
    double ratio = 1.0;
#if OIL_POINTS
    double place = spool_min(spool_max((m->oil - OIL_LOWEST) / OIL_STEP, 0.0), OIL_POINTS - 1.0);
    int below = place < OIL_POINTS - 1 ? (int)place : OIL_POINTS - 2;
    ratio = oil_ratios[below] + (place - below) * (oil_ratios[below + 1] - oil_ratios[below]);
#endif
    for (int one = 0; one < PARAMETER_COUNT; ++one)
        unit->q[one] = m->values[one] * (parameters[one].viscous ? ratio : 1.0);
    unit->computed = false;
}

static void unit_reset(spool_unit *unit)
{
    spool_state *m = &unit->state;
    memset(m, 0, sizeof *m);
    unit->started = false;
    m->step = INTERNAL_STEP_START;
    m->oil = OIL_START;
    for (int place = 0; place < PARAMETER_COUNT; ++place) m->values[place] = parameters[place].start;
    unit_changed(unit);
}

static spool_unit *unit_new(const char *name)
{
    spool_unit *unit = calloc(1, sizeof *unit);
    size_t length = name ? strlen(name) : 0;
    if (!unit) return NULL;
    unit->name = malloc(length + 1);
    if (!unit->name) {
        free(unit);
        return NULL;
    }
    memcpy(unit->name, name ? name : "", length);
    unit->name[length] = 0;
    unit_reset(unit);
    return unit;
}

static void unit_free(spool_unit *unit)
{
    if (unit) free(unit->name);
    free(unit);
}

static const spool_outputs *unit_outputs(spool_unit *unit)
{
    const spool_state *m = &unit->state;
    spool_outputs found = {m->z, m->v, 0.0, 0.0, 0.0, false};
    const double *q = unit->q;
    double s = m->v != 0.0 ? copysign(1.0, m->v) : m->s, a = m->body[0];
    if (unit->computed) return &unit->outputs;
    found.friction = drag(m->z, m->v, m->time, q);
    for (int place = 0; place < MEMORIES; ++place) found.friction += m->x.values[place];
    if (!EVENTS) s = 0.0;
    if (EVENTS && s == 0.0) {
        spool_dd bounds = rest(m->z, q);
        double need = needed_at_rest(m->z, 0.0, m->x, (spool_ddddd){m->time, 1.0, a, 0.0, 0.0}, q);
        if (bounds.f0 < bounds.f1) {
            found.stuck = bounds.f0 <= need && need <= bounds.f1;
            if (found.stuck) found.friction += need;
            else s = need > bounds.f1 ? 1.0 : -1.0;
        }
    }
    if (s != 0.0) found.friction += s * sliding(m->z, spool_max(s * m->v, 0.0), s, q);
    found.absolute = found.stuck ? a : acceleration(m->z, m->v, m->time, s, 0.0, m->z, m->x, q);
    found.relative = found.stuck ? 0.0 : found.absolute - a;
    unit->outputs = found;
    unit->computed = true;
    return &unit->outputs;
}

static bool unit_get(spool_unit *unit, uint32_t reference, double *value)
{
    const spool_state *m = &unit->state;
    const spool_outputs *found = unit_outputs(unit);
    switch (reference) {
    case TIME: *value = m->time; return true;
    case BODY_ACCELERATION: *value = m->body[0]; return true;
    case SPOOL_POSITION: *value = found->z; return true;
    case SPOOL_VELOCITY: *value = found->v; return true;
    case SPOOL_ACCELERATION: *value = found->relative; return true;
    case SPOOL_ACCELERATION_ABSOLUTE: *value = found->absolute; return true;
    case FRICTION_FORCE: *value = found->friction; return true;
    case INTERNAL_STEP: *value = m->step; return true;
    default: break;
    }
#if OIL_POINTS
    if (reference == OIL_TEMPERATURE) {
        *value = m->oil;
        return true;
    }
#endif
    if (reference >= FIRST_PARAMETER && reference - FIRST_PARAMETER < PARAMETER_COUNT) {
        *value = m->values[reference - FIRST_PARAMETER];
        return true;
    }
    unit_say(unit, "value reference %u: no such number", (unsigned)reference);
    return false;
}

static bool unit_in_range(spool_unit *unit, const char *name, double value, double low, double high)
{
    if (value >= low && value <= high) return true;
    unit_say(unit, "%s: %g is out of range, use %g to %g", name, value, low, high);
    return false;
}

static bool unit_set(spool_unit *unit, uint32_t reference, double value)
{
    spool_state *m = &unit->state;
    unit->computed = false;
    if (reference == BODY_ACCELERATION) {
        if (!unit_in_range(unit, "body_acceleration", value, -1e6, 1e6)) return false;
        m->body[0] = value;
        return true;
    }
#if OIL_POINTS
    if (reference == OIL_TEMPERATURE) {
        if (!unit_in_range(unit, "oil_temperature", value, -60.0, 250.0)) return false;
        m->oil = value;
        unit_changed(unit);
        return true;
    }
#endif
    if (reference == INTERNAL_STEP) {
        if (!unit_in_range(unit, "internal_step", value, 1e-8, 1e-2)) return false;
        m->step = value;
        return true;
    }
    if (reference >= FIRST_PARAMETER && reference - FIRST_PARAMETER < PARAMETER_COUNT) {
        int place = (int)(reference - FIRST_PARAMETER);
        const spool_parameter *one = &parameters[place];
        if (!unit_in_range(unit, one->name, value, one->low, one->high)) return false;
        m->values[place] = value;
        unit_changed(unit);
        return true;
    }
    unit_say(unit, "value reference %u cannot be set", (unsigned)reference);
    return false;
}

static double unit_body(spool_unit *unit, double begin, double after)
{
    const double *body = unit->state.body;
    if (unit->ask) {
        unit->ask(unit, begin + after);
        return body[0];
    }
    return body[0] + after * (body[1] + 0.5 * after * body[2]);
}

/* Advance by one communication step, in equal internal steps. */
static bool unit_step(spool_unit *unit, double time, double length)
{
    spool_state *m = &unit->state;
    const double *q = unit->q;
    double count, h, a0;
    if (!(length > 0.0) || length / m->step > MOST_STEPS) {
        unit_say(unit, "communication step of %g s: use more than 0 and less than %g s", length, m->step * MOST_STEPS);
        return false;
    }
    if (unit->started && fabs(time - m->time) > 1e-3 * length + 1e-9 * fabs(time)) {
        unit_say(unit, "step from %g s, but the valve is at %g s: restore a state before a step is repeated", time, m->time);
        return false;
    }
    unit->started = true;
    unit_watch(unit, length);
    count = spool_max(1.0, ceil(length / m->step - 1e-6));
    h = length / count;
    a0 = m->body[0];
    for (double number = 0.0; number < count; number += 1.0) {
        double t = time + number * h, am = unit_body(unit, time, (number + 0.5) * h);
        double a1 = unit_body(unit, time, (number + 1.0) * h);
        spool_ddddd step = step_of(t, h, a0, am, a1);
        if (EVENTS) {
            spool_dddm end = step_with_events(m->z, m->v, m->s, m->x, step, q);
            m->z = end.f0, m->v = end.f1, m->s = end.f2, m->x = end.f3;
        } else {
            double k1 = acceleration(m->z, m->v, t, 0.0, a0, m->z, m->x, q);
            spool_dd end = slip((spool_ddddd){m->z, m->v, 0.0, k1, 0.0}, m->x, h, step, q);
            m->z = end.f0, m->v = end.f1;
        }
        a0 = a1;
    }
    unit->computed = false;
    m->time = time + length;
    m->body[0] = a0;
    m->body[1] = m->body[2] = 0.0; /* hold for one step */
    if (isfinite(m->z) && isfinite(m->v)) return true;
    unit_say(unit, "at %g s the motion diverged: use a shorter internal_step", m->time);
    return false;
}
