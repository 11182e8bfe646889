#include "device.h"

#include <math.h>
#include <string.h>

enum {
    IDENTIFY = 0x01,
    CONFIGURE = 0x02,
    UPLOAD = 0x03,
    ARM = 0x04,
    START = 0x05,
    STOP = 0x06,
    QUERY = 0x07,
    TIME = 0x08,
    IDENTITY = 0x81,
    CONFIGURED = 0x82,
    STATUS = 0x87,
    TIME_REPLY = 0x88,
    MEASUREMENT = 0xc1,
    REFUSED = 0xff
};
enum { UNKNOWN = 1, MALFORMED, STATE, UNSUPPORTED, TABLE };
enum { HEAD = 2, MEASUREMENT_HEAD = 28, WIDE = 1, FLAGGED = 2 };

/* Little-endian numbers, whatever the machine's own order. */

static uint8_t *put(uint8_t *to, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        *to++ = (uint8_t)(value >> (8 * i));
    return to;
}

static uint8_t *put_f64(uint8_t *to, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, 8);
    return put(to, bits, 8);
}

static uint64_t get(const uint8_t *from, int bytes)
{
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++)
        value |= (uint64_t)from[i] << (8 * i);
    return value;
}

static double get_f64(const uint8_t *from)
{
    uint64_t bits = get(from, 8);
    double value;
    memcpy(&value, &bits, 8);
    return value;
}

/* Close a frame whose body ends at end, and send it. */
static bool send(struct device *d, uint8_t *body, uint8_t *end)
{
    static uint8_t wire[FRAME_ENCODED_MOST + 1];
    uint32_t crc = crc32_update(0, body, (size_t)(end - body));
    end = put(end, crc, 4);
    bool measurement = body[0] == MEASUREMENT;
    return d->platform->send(wire, cobs_encode(body, (size_t)(end - body), wire), measurement);
}

static void refuse(struct device *d, uint8_t tag, uint8_t code, const char *why)
{
    uint8_t body[160] = {REFUSED, tag, code};
    size_t length = strlen(why) < 150 ? strlen(why) : 150;
    memcpy(body + 3, why, length);
    send(d, body, body + 3 + length);
}

static void send_status(struct device *d, uint8_t tag)
{
    uint8_t body[64] = {STATUS, tag, d->state, d->booted, 0, 0};
    uint8_t *to = put(body + 6, d->run, 4);
    to = put(to, d->frames, 8);
    to = put(to, d->dropped, 8);
    to = put(to, (uint64_t)d->platform->now_ns(), 8);
    to = put(to, d->patterns.loaded, 4);
    send(d, body, put(to, d->table_crc, 4));
}

static void identify(struct device *d, uint8_t tag)
{
    const struct platform *p = d->platform;
    uint8_t body[160] = {IDENTITY, tag};
    uint8_t *to = put(body + HEAD, 1, 2);
    *to++ = p->adc_bits;
    *to++ = p->detectors;
    to = put(to, MOST_CELLS, 4);
    to = put(to, MOST_TABLE_BYTES, 4);
    to = put(to, KNOWN_ORDERS, 2);
    to = put(to, (1u << MODES) - 1, 2);
    *to++ = p->gains;
    *to++ = 0;
    to = put_f64(to, p->min_integration_time_s);
    to = put_f64(to, p->max_integration_time_s);
    size_t length = strlen(p->name) < 100 ? strlen(p->name) : 100;
    memcpy(to, p->name, length);
    send(d, body, to + length);
}

/* All zero: always open; else a phase shutter (frequency and phase) or a gate (delay and width). */
static bool possible(const struct shutter *s)
{
    bool phase = s->modulation_hz > 0 && s->gate_delay_s == 0 && s->gate_width_s == 0;
    bool gate = s->modulation_hz == 0 && s->phase_rad == 0 && s->gate_width_s > 0;
    bool open = s->modulation_hz == 0 && s->phase_rad == 0 && s->gate_delay_s == 0 &&
                s->gate_width_s == 0;
    return (phase || gate || open) && s->phase_rad >= 0 && s->gate_delay_s >= 0 &&
           isfinite(s->modulation_hz) && isfinite(s->phase_rad) && isfinite(s->gate_delay_s) &&
           isfinite(s->gate_width_s);
}

static void configure(struct device *d, uint8_t tag, const uint8_t *in, size_t size)
{
    const struct platform *p = d->platform;
    uint8_t n = size >= 30 ? in[11] : 0;
    if (size < 30 || n < 1 || n > MOST_SHUTTERS || size != 30 + 32u * n) {
        refuse(d, tag, MALFORMED, "Configure: its length does not fit");
        return;
    }
    double integration = get_f64(in + 14), period = get_f64(in + 22);
    struct shutter shutters[MOST_SHUTTERS];
    bool shutters_possible = true;
    for (uint8_t i = 0; i < n; i++) {
        const uint8_t *at = in + 30 + 32 * i;
        shutters[i] = (struct shutter){get_f64(at), get_f64(at + 8), get_f64(at + 16),
                                       get_f64(at + 24)};
        shutters_possible &= possible(&shutters[i]);
    }
    uint16_t asked = (uint16_t)get(in + 12, 2);
    uint16_t most =
        (uint16_t)((FRAME_MOST - HEAD - 4 - MEASUREMENT_HEAD) / (4u * p->detectors + 1u));
    const char *why = 0;
    if (d->state == STATE_RUNNING) {
        refuse(d, tag, STATE, "Configure: a run is on");
        return;
    }
    if (in[10] >= p->gains)
        why = "gain: no such step";
    else if (!(integration >= p->min_integration_time_s && integration <= p->max_integration_time_s))
        why = "integration_time_s: outside what I can do";
    else if (!(period == 0 || (period >= integration + p->readout_time_s && period <= 1e3)))
        why = "pattern_period_s: shorter than integration and read-out, or no number";
    else if (!shutters_possible)
        why = "shutters: a phase, a gate, or all zero is expected, without negative numbers";
    else
        why = patterns_set(&d->patterns, (uint32_t)get(in, 2), (uint32_t)get(in + 2, 2),
                           (uint32_t)get(in + 4, 4), in[8], in[9]);
    if (why) {
        refuse(d, tag, UNSUPPORTED, why);
        return;
    }
    memcpy(d->shutters, shutters, n * sizeof *shutters);
    d->n_shutters = n;
    d->gain = in[10];
    d->integration_time_s = integration;
    d->period_s = period > 0 ? period : integration + p->readout_time_s;
    d->exposures = d->patterns.exposures * n;
    d->per_frame = asked == 0 ? 64 : asked;
    if (d->per_frame > most)
        d->per_frame = most;
    d->table_crc = patterns_crc(&d->patterns);
    d->state = STATE_CONFIGURED;
    uint8_t body[80] = {CONFIGURED, tag};
    uint8_t *to = put(body + HEAD, d->exposures, 4);
    to = put(to, d->per_frame, 2);
    *to++ = p->detectors;
    *to++ = 0;
    to = put(to, d->patterns.size, 4);
    to = put(to, d->table_crc, 4);
    to = put_f64(to, d->integration_time_s);
    to = put_f64(to, d->period_s);
    to = put_f64(to, p->electrons_per_count(d->gain));
    send(d, body, put_f64(to, p->offset_counts(d->gain)));
}

static void upload(struct device *d, uint8_t tag, const uint8_t *in, size_t size)
{
    struct patterns *p = &d->patterns;
    uint32_t offset = size >= 4 ? (uint32_t)get(in, 4) : 0, length = (uint32_t)size - 4;
    if (size < 5) {
        refuse(d, tag, MALFORMED, "Upload: no bytes");
        return;
    }
    if (d->state != STATE_CONFIGURED || p->order != ORDER_UPLOADED) {
        refuse(d, tag, STATE, "Upload: configure for it first");
        return;
    }
    if (offset > (p->kept ? 0 : p->loaded) || length > p->size || offset > p->size - length) {
        refuse(d, tag, TABLE, "Upload: beyond what is here, or beyond the table");
        return;
    }
    if (p->kept) {
        p->kept = false;
        p->loaded = 0;
        d->table_crc = 0;
    }
    memcpy(p->bits + offset, in + 4, length);
    if (offset + length > p->loaded)
        p->loaded = offset + length; /* an earlier portion again takes nothing away */
    if (p->loaded == p->size)
        d->table_crc = patterns_crc(p);
    send_status(d, tag);
}

static void arm(struct device *d, uint8_t tag, const uint8_t *in, size_t size)
{
    if (size != 4)
        refuse(d, tag, MALFORMED, "Arm: its length does not fit");
    else if (d->state != STATE_CONFIGURED && d->state != STATE_ARMED)
        refuse(d, tag, STATE, "Arm: configure first");
    else if (d->patterns.loaded != d->patterns.size || get(in, 4) != d->table_crc)
        refuse(d, tag, TABLE, "Arm: this is not the table that I hold");
    else {
        d->state = STATE_ARMED;
        send_status(d, tag);
    }
}

static void start(struct device *d, uint8_t tag, const uint8_t *in, size_t size)
{
    if (size != 12) {
        refuse(d, tag, MALFORMED, "Start: its length does not fit");
        return;
    }
    uint32_t run = (uint32_t)get(in, 4);
    bool again = d->run == run && !d->booted; /* asked twice, because our reply was lost */
    if (!again && d->state != STATE_ARMED) {
        refuse(d, tag, STATE, "Start: arm first");
        return;
    }
    if (!again) {
        d->run = run;
        d->sets = get(in + 4, 8);
        d->set = d->frames = d->dropped = 0;
        d->exposure = d->in_frame = 0;
        d->mark = d->booted ? FLAG_RESET : 0;
        d->booted = 0;
        d->start_ns = d->platform->now_ns();
        d->state = STATE_RUNNING;
    }
    send_status(d, tag);
}

static void answer(struct device *d, const uint8_t *frame, size_t size)
{
    uint8_t type = frame[0], tag = frame[1];
    const uint8_t *in = frame + HEAD;
    size_t length = size - HEAD - 4;
    if ((type == IDENTIFY || type == STOP || type == QUERY) && length != 0) {
        refuse(d, tag, MALFORMED, "a payload where there is none");
        return;
    }
    switch (type) {
    case IDENTIFY:
        identify(d, tag);
        break;
    case CONFIGURE:
        configure(d, tag, in, length);
        break;
    case UPLOAD:
        upload(d, tag, in, length);
        break;
    case ARM:
        arm(d, tag, in, length);
        break;
    case START:
        start(d, tag, in, length);
        break;
    case STOP:
        if (d->state == STATE_RUNNING)
            d->state = STATE_ARMED;
        send_status(d, tag);
        break;
    case QUERY:
        send_status(d, tag);
        break;
    case TIME: {
        uint8_t body[40] = {TIME_REPLY, tag};
        int64_t received = d->platform->now_ns();
        if (length != 8) {
            refuse(d, tag, MALFORMED, "Time: its length does not fit");
            break;
        }
        memcpy(body + HEAD, in, 8);
        uint8_t *to = put(body + HEAD + 8, (uint64_t)received, 8);
        send(d, body, put(to, (uint64_t)d->platform->now_ns(), 8));
        break;
    }
    default:
        refuse(d, tag, UNKNOWN, "no request of the protocol");
    }
}

void device_start(struct device *d, const struct platform *platform)
{
    memset(d, 0, sizeof *d);
    d->platform = platform;
    d->booted = 1;
    send_status(d, 0);
}

void device_receive(struct device *d, const uint8_t *data, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        if (data[i] != 0) {
            if (d->input_size < sizeof d->input)
                d->input[d->input_size++] = data[i];
            else
                d->input_skip = true;
            continue;
        }
        size_t length = d->input_skip ? 0 : cobs_decode(d->input, d->input_size, d->input);
        d->input_size = 0;
        d->input_skip = false;
        if (length < HEAD + 4 || length > FRAME_MOST)
            continue;
        if (crc32_update(0, d->input, length - 4) == get(d->input + length - 4, 4))
            answer(d, d->input, length);
    }
}

/* Device time at which an exposure of the running set begins, or would after its end. */
static int64_t begins_ns(const struct device *d, uint32_t exposure)
{
    double since_s = ((double)d->set * d->exposures + exposure) * d->period_s;
    return d->start_ns + llround(since_s * 1e9);
}

static void send_measurement(struct device *d)
{
    uint32_t n = d->in_frame, first = d->exposure - n, values = n * d->platform->detectors;
    bool wide = false, flagged = false;
    for (uint32_t i = 0; i < values; i++)
        wide |= d->counts[i] > 0xffff;
    for (uint32_t i = 0; i < n; i++)
        flagged |= d->flags[i] != 0;
    uint8_t body[FRAME_MOST] = {MEASUREMENT, 0};
    uint8_t *to = put(body + HEAD, d->run, 4);
    to = put(to, d->frames, 8);
    to = put(to, (uint64_t)begins_ns(d, first), 8);
    to = put(to, first, 4);
    to = put(to, n, 2);
    *to++ = d->platform->detectors;
    *to++ = (uint8_t)((wide ? WIDE : 0) | (flagged ? FLAGGED : 0));
    for (uint32_t i = 0; i < values; i++)
        to = put(to, (uint32_t)d->counts[i], wide ? 4 : 2);
    for (uint32_t i = 0; flagged && i < n; i++)
        *to++ = d->flags[i];
    d->frames++;
    d->in_frame = 0;
    if (!send(d, body, to)) {
        d->dropped++;
        d->mark |= FLAG_OVERRUN;
    }
}

/* Go on with this exposure of this set; the run may be over. */
static void go_to(struct device *d, uint64_t set, uint32_t exposure)
{
    d->set = set;
    d->exposure = exposure;
    if (d->sets != 0 && d->set >= d->sets) {
        d->state = STATE_ARMED;
        send_status(d, 0);
    }
}

static void expose_next(struct device *d)
{
    uint32_t pattern = d->exposure / d->n_shutters, shutter = d->exposure % d->n_shutters;
    uint8_t flags = d->platform->expose(&d->patterns, pattern, &d->shutters[shutter], d->gain,
                                        d->integration_time_s,
                                        d->counts + d->in_frame * d->platform->detectors);
    d->flags[d->in_frame++] = flags | d->mark;
    d->mark = 0;
    d->exposure++;
    if (d->in_frame == d->per_frame || d->exposure == d->exposures)
        send_measurement(d);
    if (d->exposure == d->exposures)
        go_to(d, d->set + 1, 0);
}

/* What is too late to be read out is lost: drop whole frames, up to one that has not begun. */
static void drop_late(struct device *d, int64_t now_ns)
{
    uint64_t begun = (uint64_t)ceil((double)(now_ns - d->start_ns) / (d->period_s * 1e9));
    uint64_t set = begun / d->exposures, per_set = (d->exposures - 1) / d->per_frame + 1;
    uint64_t frame = (begun % d->exposures + d->per_frame - 1) / d->per_frame;
    if (frame == per_set) {
        frame = 0;
        set++;
    }
    if (d->sets != 0 && set >= d->sets) {
        frame = 0;
        set = d->sets;
    }
    d->dropped += set * per_set + frame - d->frames;
    d->frames = set * per_set + frame;
    d->in_frame = 0;
    d->mark |= FLAG_OVERRUN;
    go_to(d, set, (uint32_t)frame * d->per_frame);
}

int64_t device_poll(struct device *d)
{
    for (uint32_t n = 0; d->state == STATE_RUNNING; n++) {
        int64_t due = begins_ns(d, d->exposure) + llround(d->integration_time_s * 1e9);
        int64_t now = d->platform->now_ns();
        if (due > now || n == POLL_EXPOSURES)
            return due;
        if (now - due > d->platform->backlog_ns)
            drop_late(d, now);
        else
            expose_next(d);
    }
    return -1;
}
