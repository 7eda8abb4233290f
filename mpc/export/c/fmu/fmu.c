/* The functions of FMI 3.0 that a co-simulation in samples of fixed length has. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "unit.h"

typedef enum { BEGUN, INITIALISING, STEPPING, OVER } phase;

/* The saved and restored state of an FMU; the memory of the unit follows it. */
typedef struct {
    unsigned long long check; /* of a state that is kept: the hash of all that follows */
    unsigned long long model; /* the hash of the token of the FMU that it belongs to */
    phase phase;
    double start;    /* [s] */
    long long steps; /* since then */
    double v[UNIT_VALUES];
} state;

typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    state *now;
    state *before; /* the step that is under way */
} instance_data;

static const double STARTS[UNIT_VALUES] = UNIT_STARTS;
static const unit_variable VARIABLES[UNIT_VARIABLES] = UNIT_TABLE; /* by their references, from 1 on; 0 is the time */
static const double NEAR = 1e-6;                                   /* of a sample: a time that near is the same */
static const double MOST_SAMPLES = 1e6;                            /* of one step, so that it returns */

static size_t state_size(void) { return sizeof(state) + unit_memory_size(); }

static unit_memory *memory_of(state *s) { return (unit_memory *)(void *)(s + 1); }

/* FNV-1a, 64 bits. */
static unsigned long long hash_of(const void *bytes, size_t size) {
    unsigned long long hash = 14695981039346656037ULL;
    for (size_t k = 0; k < size; k++) hash = (hash ^ ((const unsigned char *)bytes)[k]) * 1099511628211ULL;
    return hash;
}

static unsigned long long model_hash(void) { return hash_of(UNIT_TOKEN, sizeof UNIT_TOKEN); }

static unsigned long long check_of(const state *s) {
    return hash_of((const unsigned char *)s + sizeof s->check, state_size() - sizeof s->check);
}

/* Whether the bytes are an unchanged state of this FMU. */
static int is_state(const void *bytes) {
    state head;
    memcpy(&head, bytes, sizeof head);
    return head.model == model_hash() && head.check == check_of(bytes);
}

static double time_of(const state *s) { return s->start + (double)s->steps * UNIT_DT; }

fmi3Status unit_complain(fmi3Instance instance, const char *format, ...) {
    const instance_data *it = instance;
    char sentence[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    if (it && it->log) it->log(it->environment, fmi3Error, "logStatusError", sentence);
    return fmi3Error;
}

/* --- creation and phases ----------------------------------------------------------------------------------------- */

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)instance; /* errors are all that it logs */
    (void)on;
    (void)n;
    (void)categories;
    return fmi3OK;
}

static void begin(state *s) {
    memset(s, 0, state_size());
    s->model = model_hash();
    memcpy(s->v, STARTS, sizeof s->v);
    s->phase = BEGUN;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)events;
    (void)early;
    (void)required;
    (void)n;
    (void)update;
    instance_data *it = calloc(1, sizeof *it);
    if (!it) return NULL;
    it->environment = environment;
    it->log = log;
    it->now = malloc(state_size());
    it->before = malloc(state_size());
    const int known = token && strcmp(token, UNIT_TOKEN) == 0;
    if (!it->now || !it->before || !known) {
        if (!known)
            unit_complain(it, "the instantiation token is %s, not that of modelDescription.xml",
                          token ? token : "missing");
        else
            unit_complain(it, "there is no memory for the instance");
        fmi3FreeInstance(it);
        return NULL;
    }
    begin(it->now);
    return it;
}

void fmi3FreeInstance(fmi3Instance instance) {
    instance_data *it = instance;
    if (!it) return;
    free(it->now);
    free(it->before);
    free(it);
}

/* Whether the FMU is in this phase; reports an error if not. */
static int in(instance_data *it, phase wanted, const char *what) {
    if (it->now->phase == wanted) return 1;
    unit_complain(it, "%s is not for this phase of the simulation", what);
    return 0;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerant, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean ends, fmi3Float64 stop) {
    instance_data *it = instance;
    (void)tolerant;
    (void)tolerance;
    (void)ends;
    (void)stop;
    if (!in(it, BEGUN, "to initialise")) return fmi3Error;
    if (!isfinite(start)) return unit_complain(it, "the start time of %g s has to be finite", start);
    it->now->start = start;
    it->now->phase = INITIALISING;
    unit_begin(memory_of(it->now), it->now->v);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    instance_data *it = instance;
    if (!in(it, INITIALISING, "to end the initialisation")) return fmi3Error;
    it->now->phase = STEPPING;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    instance_data *it = instance;
    if (!in(it, STEPPING, "to terminate")) return fmi3Error;
    it->now->phase = OVER;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    instance_data *it = instance;
    begin(it->now);
    return fmi3OK;
}

/* --- values ------------------------------------------------------------------------------------------------------ */

static const unit_variable *variable_of(instance_data *it, fmi3ValueReference reference, int whole) {
    if (reference >= 1 && reference <= UNIT_VARIABLES && VARIABLES[reference - 1].whole == whole)
        return &VARIABLES[reference - 1];
    unit_complain(it, "there is no %s variable with the reference %u", whole ? "Int32" : "Float64", (unsigned)reference);
    return NULL;
}

/* Whether the number of values is that of the variables. */
static int enough(instance_data *it, size_t used, size_t n) {
    if (used == n) return 1;
    unit_complain(it, "the variables have %u values, not %u", (unsigned)used, (unsigned)n);
    return 0;
}

/* Copy the values of the variables; *used counts them even if there is no room. */
static int get(instance_data *it, const fmi3ValueReference references[], size_t n, int whole, double *reals,
               fmi3Int32 *integers, size_t room) {
    size_t used = 0;
    for (size_t k = 0; k < n; k++) {
        static const unit_variable clock = {0, -1, 1, 0, 0};
        const unit_variable *variable = !whole && references[k] == 0 ? &clock : variable_of(it, references[k], whole);
        if (!variable) return 0;
        for (int j = 0; j < variable->count; j++, used++) {
            const double value = variable->first < 0 ? time_of(it->now) : it->now->v[variable->first + j];
            if (used < room && reals) reals[used] = value;
            if (used < room && integers) integers[used] = (fmi3Int32)value;
        }
    }
    return enough(it, used, room);
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t room) {
    return get(instance, references, n, 0, values, NULL, room) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Int32 values[],
                        size_t room) {
    return get(instance, references, n, 1, NULL, values, room) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                          const fmi3Float64 values[], size_t given) {
    instance_data *it = instance;
    size_t used = 0;
    for (size_t k = 0; k < n; k++) {
        const unit_variable *variable = variable_of(it, references[k], 0);
        if (!variable) return fmi3Error;
        if (variable->set == 0 || (variable->set == 1 && it->now->phase > INITIALISING) || it->now->phase == OVER)
            return unit_complain(it, "the variable with the reference %u cannot be set now", (unsigned)references[k]);
        for (int j = 0; variable->finite && j < variable->count && used + (size_t)j < given; j++)
            if (!isfinite(values[used + (size_t)j]))
                return unit_complain(it, "the variable with the reference %u has to be finite, not %g",
                                     (unsigned)references[k], values[used + (size_t)j]);
        used += (size_t)variable->count;
    }
    if (!enough(it, used, given)) return fmi3Error;
    used = 0;
    for (size_t k = 0; k < n; k++) {
        const unit_variable *variable = variable_of(it, references[k], 0);
        memcpy(it->now->v + variable->first, values + used, (size_t)variable->count * sizeof *values);
        used += (size_t)variable->count;
    }
    if (it->now->phase == INITIALISING) unit_begin(memory_of(it->now), it->now->v);
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                        const fmi3Int32 values[], size_t given) {
    (void)references;
    (void)values;
    return n || given ? unit_complain(instance, "no Int32 variable can be set") : fmi3OK;
}

/* --- steps ------------------------------------------------------------------------------------------------------- */

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 now, fmi3Float64 size, fmi3Boolean final, fmi3Boolean *events,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached) {
    instance_data *it = instance;
    (void)final;
    *events = *terminate = *early = fmi3False;
    *reached = time_of(it->now);
    if (!in(it, STEPPING, "a step")) return fmi3Error;
    const double samples = round(size / UNIT_DT);
    if (!(samples <= MOST_SAMPLES))
        return unit_complain(it, "a step of %g s is longer than %g samples of %g s", size, MOST_SAMPLES, UNIT_DT);
    if (!(samples >= 1) || !(fabs(size - samples * UNIT_DT) <= NEAR * UNIT_DT))
        return unit_complain(it, "a step of %g s is no multiple of the sample time of %g s", size, UNIT_DT);
    if (!(fabs(now - *reached) <= 0.5 * UNIT_DT))
        return unit_complain(it, "a step from %g s on, when it is %g s", now, *reached);
    memcpy(it->before, it->now, state_size());
    for (double k = 0; k < samples; k++) {
        if (!unit_advance(memory_of(it->now), it->now->v)) {
            memcpy(it->now, it->before, state_size());
            return unit_complain(it, "the inputs lead out of the numbers: no step from %g s on was taken", *reached);
        }
        it->now->steps++;
    }
    *reached = time_of(it->now);
    return fmi3OK;
}

/* --- the state of the FMU ---------------------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *kept) {
    const instance_data *it = instance;
    if (!*kept) *kept = malloc(state_size());
    if (!*kept) return unit_complain(instance, "there is no memory for the state");
    state *made = *kept;
    memcpy(made, it->now, state_size());
    made->check = check_of(made);
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState kept) {
    const instance_data *it = instance;
    if (!kept) return unit_complain(instance, "there is no state to go back to");
    if (!is_state(kept)) return unit_complain(instance, "this is no state of this FMU, or it was changed");
    memcpy(it->now, kept, state_size());
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *kept) {
    (void)instance;
    free(*kept);
    *kept = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState kept, size_t *size) {
    (void)instance;
    (void)kept;
    *size = state_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState kept, fmi3Byte bytes[], size_t size) {
    if (size != state_size()) return unit_complain(instance, "a state has another size than %u", (unsigned)size);
    if (!kept || !is_state(kept)) return unit_complain(instance, "this is no state of this FMU, or it was changed");
    memcpy(bytes, kept, size);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *kept) {
    if (size != state_size()) return unit_complain(instance, "a state has another size than %u", (unsigned)size);
    if (!is_state(bytes)) return unit_complain(instance, "the bytes are no state of this FMU, or damaged");
    if (!*kept) *kept = malloc(size);
    if (!*kept) return unit_complain(instance, "there is no memory for the state");
    memcpy(*kept, bytes, size);
    return fmi3OK;
}
