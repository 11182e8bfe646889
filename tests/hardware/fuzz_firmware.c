/* The firmware for a fuzzer: one input is what a host sends to a device that has just started.
 *
 * Built with -fsanitize-coverage=trace-pc: every edge counts in a table that libFuzzer watches. */
#include "device.h"

#include <stdlib.h>

#define COUNTERS 16384u
#define POLLS 8

uint8_t counters[COUNTERS];

/* This file itself is compiled without coverage. */
void __sanitizer_cov_trace_pc(void)
{
    /* Relative to this function: the same from run to run. */
    uintptr_t at = (uintptr_t)__builtin_return_address(0) - (uintptr_t)&__sanitizer_cov_trace_pc;
    uint8_t *counter = &counters[at % COUNTERS];
    if (*counter < 255)
        ++*counter;
}

static int64_t time_ns;

static int64_t now_ns(void) { return time_ns += 1000; }

/* What goes out must be one whole frame: no zero but the last byte, and it unstuffs. */
static bool check(const uint8_t *data, size_t size, bool measurement)
{
    static uint8_t body[FRAME_ENCODED_MOST];
    (void)measurement;
    if (size < 2 || size > FRAME_ENCODED_MOST + 1 || data[size - 1])
        abort();
    for (size_t i = 0; i + 1 < size; i++)
        if (!data[i])
            abort();
    if (cobs_decode(data, size - 1, body) < 6)
        abort();
    return time_ns / 1000 % 5; /* now and then the line takes no more */
}

static uint8_t expose(const struct patterns *p, uint32_t exposure, const struct shutter *shutter,
                      uint8_t gain, double integration_time_s, int32_t *counts)
{
    (void)shutter, (void)gain, (void)integration_time_s;
    for (uint32_t d = 0; d < 2; d++)
        counts[d] = patterns_lit(p, exposure, exposure % (p->rows * p->columns)) ? 70000 : 0;
    return 0;
}

static double one(uint8_t gain) { return (void)gain, 1.0; }

static const struct platform platform = {
    .name = "fuzzed",
    .adc_bits = 18,
    .detectors = 2,
    .gains = 2,
    .min_integration_time_s = 1e-6,
    .max_integration_time_s = 1.0,
    .readout_time_s = 1e-6,
    .backlog_ns = 300000,
    .now_ns = now_ns,
    .send = check,
    .expose = expose,
    .electrons_per_count = one,
    .offset_counts = one,
};

/* An overflow within the device is none that the compiler sees. */
static void check_bounds(const struct device *d)
{
    const struct patterns *p = &d->patterns;
    if (p->loaded > p->size || p->rows * p->columns > MOST_CELLS)
        abort();
    if (p->order == ORDER_UPLOADED && p->size > MOST_TABLE_BYTES)
        abort();
    if (d->exposure > d->exposures || d->in_frame > d->per_frame || d->n_shutters > MOST_SHUTTERS)
        abort();
    if (d->per_frame * 2u > sizeof d->counts / sizeof d->counts[0])
        abort();
}

/* Returns the state in which the device ends. */
int one_input(const uint8_t *data, size_t size)
{
    static struct device device;
    time_ns = 0;
    device_start(&device, &platform);
    device_receive(&device, data, size);
    check_bounds(&device);
    for (int i = 0; i < POLLS; i++) {
        time_ns += 1000000;
        device_poll(&device);
        check_bounds(&device);
    }
    return device.state;
}
