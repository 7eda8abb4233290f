/* The board answers one request after the other. Only WRITE and FOLLOW move the valves, as long as the host keeps
 * sending them: if it is silent for ANT_WATCHDOG_US, the pressures fall and it has to start a new session. */
#include "board.h"

#include <math.h>
#include <string.h>

enum { BYTES_AT_ONCE = 64 }; /* read in a call: noise on the line must not keep the watchdog from its work */
static const uint32_t FALL_EVERY_US = 1000;

static int obeys(const ant_board *b) { return b->state == ANT_STATE_DIRECT || b->state == ANT_STATE_FOLLOWING; }

static void set_valves(ant_board *b, const float P[ANT_MUSCLES]) {
    memmove(b->u, P, sizeof b->u);
    b->moved = clock_us();
    write_valves(b->u);
}

/* All pressures to the least and a share of what they are above it. */
static void lower(ant_board *b, float share) {
    float P[ANT_MUSCLES];
    for (int i = 0; i < ANT_MUSCLES; i++) P[i] = ANT_LOW + share * (b->u[i] - ANT_LOW);
    set_valves(b, P);
}

/* All pressures to the least, in their ratio and with it about the angles, the highest by ANT_FALL. */
static void fall(ant_board *b) {
    const uint32_t passed = clock_us() - b->moved;
    float highest = 0;
    for (int i = 0; i < ANT_MUSCLES; i++)
        if (b->u[i] - ANT_LOW > highest) highest = b->u[i] - ANT_LOW;
    if (passed < FALL_EVERY_US || !(highest > 0)) return;
    const float step = ANT_FALL * ((float)passed * 1e-6f);
    lower(b, step < highest ? 1 - step / highest : 0);
}

/* --- answers ----------------------------------------------------------------------------------------------------- */

static void answer(const ant_board *b, ant_kind kind, uint8_t *payload, size_t bytes) {
    uint8_t line[ANT_LINE_BYTES];
    payload[ANT_HEADER_KIND] = (uint8_t)kind;
    ant_put_u16(payload + ANT_HEADER_SESSION, b->session);
    ant_put_u16(payload + ANT_HEADER_SEQUENCE, b->sequence);
    send_bytes(line, ant_frame(payload, ANT_HEADER_BYTES + bytes, line));
}

static void answer_refused(const ant_board *b, const uint8_t *request, ant_refusal reason) {
    uint8_t payload[ANT_HEADER_BYTES + ANT_REFUSED_BYTES], *body = payload + ANT_HEADER_BYTES, line[ANT_LINE_BYTES];
    memcpy(payload, request, ANT_HEADER_BYTES); /* its session and sequence, which need not be the board's */
    payload[ANT_HEADER_KIND] = ANT_KIND_REFUSED;
    body[ANT_REFUSED_REASON] = (uint8_t)reason;
    body[ANT_REFUSED_STATE] = (uint8_t)b->state;
    send_bytes(line, ant_frame(payload, sizeof payload, line));
}

static void answer_accepted(const ant_board *b) {
    uint8_t payload[ANT_HEADER_BYTES + ANT_ACCEPTED_BYTES];
    payload[ANT_HEADER_BYTES + ANT_ACCEPTED_STATE] = (uint8_t)b->state;
    answer(b, ANT_KIND_ACCEPTED, payload, ANT_ACCEPTED_BYTES);
}

static void answer_info(const ant_board *b) {
    uint8_t payload[ANT_HEADER_BYTES + ANT_INFO_BYTES], *body = payload + ANT_HEADER_BYTES;
    body[ANT_INFO_VERSION] = ANT_PROTOCOL;
    body[ANT_INFO_JOINTS] = ANT_JOINTS;
    body[ANT_INFO_MUSCLES] = ANT_MUSCLES;
#ifdef ANT_BOARD_CONTROLS
    ant_put_u16(body + ANT_INFO_AHEAD, ANT_AHEAD);
    ant_put_u16(body + ANT_INFO_ROOM, ANT_ROOM);
    ant_put_u32(body + ANT_INFO_DT, ANT_TICK_US);
#else
    ant_put_u16(body + ANT_INFO_AHEAD, 0);
    ant_put_u16(body + ANT_INFO_ROOM, 0);
    ant_put_u32(body + ANT_INFO_DT, 0);
#endif
    ant_put_f32(body + ANT_INFO_LOW, ANT_LOW);
    ant_put_f32(body + ANT_INFO_HIGH, ANT_HIGH);
    ant_put_u32(body + ANT_INFO_WATCHDOG, ANT_WATCHDOG_US);
    ant_put_f32(body + ANT_INFO_FALL, ANT_FALL);
    body[ANT_INFO_STATE] = (uint8_t)b->state;
    answer(b, ANT_KIND_INFO, payload, ANT_INFO_BYTES);
}

/* The common beginning of READING and TRACKING. */
static void put_measured(const ant_board *b, uint8_t *body) {
    const ant_sensors s = read_sensors();
    ant_put_u32(body + ANT_READING_T, clock_us());
    ant_put_row(body + ANT_READING_THETA, s.theta, ANT_JOINTS);
    ant_put_row(body + ANT_READING_P, s.P, ANT_MUSCLES);
    ant_put_u16(body + ANT_READING_DAMAGED, b->receiver.damaged);
}

static void answer_reading(const ant_board *b) {
    uint8_t payload[ANT_HEADER_BYTES + ANT_READING_BYTES], *body = payload + ANT_HEADER_BYTES;
    put_measured(b, body);
    body[ANT_READING_STATE] = (uint8_t)b->state;
    answer(b, ANT_KIND_READING, payload, ANT_READING_BYTES);
}

#ifdef ANT_BOARD_CONTROLS
static void answer_tracking(const ant_board *b) {
    uint8_t payload[ANT_HEADER_BYTES + ANT_TRACKING_BYTES], *body = payload + ANT_HEADER_BYTES;
    const ant_follower *f = &b->follower;
    put_measured(b, body);
    ant_put_row(body + ANT_TRACKING_U, b->u, ANT_MUSCLES);
    ant_put_u32(body + ANT_TRACKING_SAMPLE, f->sample);
    ant_put_u32(body + ANT_TRACKING_NEXT, f->have);
    body[ANT_TRACKING_STATUS] = (uint8_t)(int8_t)f->plan.status;
    body[ANT_TRACKING_RUNG] = (uint8_t)(int8_t)f->plan.rung;
    body[ANT_TRACKING_RUNNING] = (uint8_t)f->running;
    body[ANT_TRACKING_STATE] = (uint8_t)b->state;
    answer(b, ANT_KIND_TRACKING, payload, ANT_TRACKING_BYTES);
}
#endif

/* --- requests ---------------------------------------------------------------------------------------------------- */

static int within(const float P[ANT_MUSCLES]) {
    for (int i = 0; i < ANT_MUSCLES; i++)
        if (!(P[i] >= ANT_LOW && P[i] <= ANT_HIGH)) return 0; /* which NaN is not */
    return 1;
}

static int safe(const ant_board *b) { return b->state == ANT_STATE_TRIPPED || b->state == ANT_STATE_VENTED; }

static void greet(ant_board *b, const uint8_t *request) {
    if (request[ANT_HEADER_BYTES + ANT_HELLO_VERSION] != ANT_PROTOCOL) {
        answer_refused(b, request, ANT_REFUSAL_VERSION);
        return;
    }
    b->session = ant_get_u16(request + ANT_HEADER_SESSION);
    b->sequence = ant_get_u16(request + ANT_HEADER_SEQUENCE);
    if (obeys(b)) b->moved = clock_us();
    b->state = ANT_STATE_READY; /* the pressures fall in it until a command arrives */
    answer_info(b);
}

static void heed(ant_board *b, ant_state state) {
    b->state = state;
    b->heard = clock_us();
    b->commands++;
}

static void write_request(ant_board *b, const uint8_t *request) {
    float P[ANT_MUSCLES];
    ant_get_row(request + ANT_HEADER_BYTES + ANT_WRITE_P, P, ANT_MUSCLES);
    if (safe(b)) {
        answer_refused(b, request, ANT_REFUSAL_SAFE);
    } else if (!within(P)) {
        answer_refused(b, request, ANT_REFUSAL_VALUE);
    } else {
        heed(b, ANT_STATE_DIRECT);
        set_valves(b, P);
        answer_accepted(b);
    }
}

static void vent_request(ant_board *b) {
    b->state = ANT_STATE_VENTED;
    lower(b, 0);
    answer_accepted(b);
}

#ifdef ANT_BOARD_CONTROLS
static void follow_request(ant_board *b, const uint8_t *request, size_t bytes) {
    const uint32_t first = ant_get_u32(request + ANT_HEADER_BYTES + ANT_FOLLOW_FIRST);
    const uint8_t *samples = request + ANT_HEADER_BYTES + ANT_FOLLOW_BYTES;
    const uint32_t n = (uint32_t)((bytes - ANT_FOLLOW_BYTES) / ANT_SAMPLE_BYTES);
    if (safe(b)) {
        answer_refused(b, request, ANT_REFUSAL_SAFE);
        return;
    }
    if (b->state != ANT_STATE_FOLLOWING && first == 0) ant_follower_begin(&b->follower);
    if (b->state != ANT_STATE_FOLLOWING && first != 0) {
        answer_refused(b, request, ANT_REFUSAL_GAP);
        return;
    }
    const int refusal = ant_follower_take(&b->follower, first, samples, n);
    if (refusal) {
        answer_refused(b, request, (ant_refusal)refusal);
        return;
    }
    heed(b, ANT_STATE_FOLLOWING);
    answer_tracking(b);
}
#endif

/* Whether the body has the length that its kind has. */
static int well_formed(uint8_t kind, size_t bytes) {
    switch (kind) {
        case ANT_KIND_HELLO: return bytes == ANT_HELLO_BYTES;
        case ANT_KIND_READ: return bytes == ANT_READ_BYTES;
        case ANT_KIND_WRITE: return bytes == ANT_WRITE_BYTES;
        case ANT_KIND_VENT: return bytes == ANT_VENT_BYTES;
#ifdef ANT_BOARD_CONTROLS
        case ANT_KIND_FOLLOW:
            return bytes >= ANT_FOLLOW_BYTES && (bytes - ANT_FOLLOW_BYTES) % ANT_SAMPLE_BYTES == 0 &&
                   (bytes - ANT_FOLLOW_BYTES) / ANT_SAMPLE_BYTES <= ANT_BATCH;
#endif
        default: return 0;
    }
}

static void obey(ant_board *b, const uint8_t *request, size_t bytes) {
    const uint8_t kind = request[ANT_HEADER_KIND];
    const uint16_t sequence = ant_get_u16(request + ANT_HEADER_SEQUENCE);
    if (!well_formed(kind, bytes)) {
        answer_refused(b, request, ANT_REFUSAL_UNKNOWN);
        return;
    }
    if (kind == ANT_KIND_HELLO) {
        greet(b, request);
        return;
    }
    if (b->state == ANT_STATE_IDLE || ant_get_u16(request + ANT_HEADER_SESSION) != b->session) {
        answer_refused(b, request, ANT_REFUSAL_SESSION);
        return;
    }
    if ((uint16_t)(sequence - b->sequence) >= 0x8000) { /* older, counted around */
        answer_refused(b, request, ANT_REFUSAL_STALE);
        return;
    }
    b->sequence = sequence;
    switch (kind) {
        case ANT_KIND_READ: answer_reading(b); break;
        case ANT_KIND_WRITE: write_request(b, request); break;
        case ANT_KIND_VENT: vent_request(b); break;
#ifdef ANT_BOARD_CONTROLS
        case ANT_KIND_FOLLOW: follow_request(b, request, bytes); break;
#endif
        default: break;
    }
}

/* --- time -------------------------------------------------------------------------------------------------------- */

#ifdef ANT_BOARD_CONTROLS
static void follow(ant_board *b) {
    if (b->state != ANT_STATE_FOLLOWING || !ant_follower_step(&b->follower)) return;
    float P[ANT_MUSCLES];
    for (int i = 0; i < ANT_MUSCLES; i++) P[i] = (float)b->follower.plan.u[0][i];
    set_valves(b, P);
}
#endif

static void watch(ant_board *b) {
    const uint32_t now = clock_us();
    if (!obeys(b) || now - b->heard <= ANT_WATCHDOG_US) return;
    b->state = ANT_STATE_TRIPPED;
    b->moved = now; /* the fall begins now */
}

void ant_board_begin(ant_board *b) {
    memset(b, 0, sizeof *b);
    b->state = ANT_STATE_IDLE;
    lower(b, 0);
}

void ant_board_poll(ant_board *b) {
    watch(b); /* first: a command that has waited in the buffer for longer than that is none any more */
    for (int i = 0; i < BYTES_AT_ONCE; i++) {
        const int byte = receive_byte();
        if (byte < 0) break;
        const size_t n = ant_receive(&b->receiver, (uint8_t)byte);
        if (n) obey(b, b->receiver.bytes, n - ANT_HEADER_BYTES);
    }
#ifdef ANT_BOARD_CONTROLS
    follow(b);
#endif
    if (!obeys(b)) fall(b);
}
