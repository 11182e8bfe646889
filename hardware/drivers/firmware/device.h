/* A single-pixel camera that speaks the protocol of ../PROTOCOL.md, without vendor code.
 *
 * Give it bytes with device_receive, call device_poll as often as you can (or from the timer that
 * strobes emitter and ADC), and implement the platform's four functions. */
#ifndef DEVICE_H
#define DEVICE_H

#include "frame.h"
#include "patterns.h"

#define MOST_DETECTORS 8u
#define MOST_SHUTTERS 64u
#define POLL_EXPOSURES 64u

enum { FLAG_SATURATED = 1, FLAG_OVERRUN = 2, FLAG_RESET = 4 };
enum { STATE_IDLE, STATE_CONFIGURED, STATE_ARMED, STATE_RUNNING };

struct shutter {
    double modulation_hz, phase_rad, gate_delay_s, gate_width_s;
};

struct platform {
    const char *name;
    uint8_t adc_bits, detectors, gains;
    double min_integration_time_s, max_integration_time_s, readout_time_s;
    /* Device clock. */
    int64_t (*now_ns)(void);
    /* How long a measured exposure waits to be read out: the depth of the ADC's buffer. */
    int64_t backlog_ns;
    /* Send a whole frame, or nothing of it and return false. Measurements leave room for answers. */
    bool (*send)(const uint8_t *data, size_t size, bool measurement);
    /* Show a pattern and measure: counts of the detectors; returns flags. */
    uint8_t (*expose)(const struct patterns *p, uint32_t exposure, const struct shutter *shutter,
                      uint8_t gain, double integration_time_s, int32_t *counts);
    /* What a count is worth at a gain. */
    double (*electrons_per_count)(uint8_t gain);
    double (*offset_counts)(uint8_t gain);
};

struct device {
    const struct platform *platform;
    struct patterns patterns;
    uint8_t state, booted, gain, n_shutters;
    uint16_t per_frame;
    struct shutter shutters[MOST_SHUTTERS];
    double integration_time_s, period_s;
    uint32_t exposures; /* of a set: patterns times shutters */
    uint32_t table_crc;
    uint32_t run;
    uint64_t sets, set;       /* asked for, 0 without end; running */
    uint64_t frames, dropped; /* of this run */
    int64_t start_ns;         /* of the run */
    uint32_t exposure;        /* next one of the set */
    uint32_t in_frame;        /* exposures of the frame being filled */
    uint8_t mark;             /* flags that the next exposure carries besides its own */
    int32_t counts[FRAME_MOST / 4];
    uint8_t flags[FRAME_MOST / 4];
    uint8_t input[FRAME_ENCODED_MOST];
    size_t input_size;
    bool input_skip;
};

void device_start(struct device *d, const struct platform *platform);
void device_receive(struct device *d, const uint8_t *data, size_t size);
/* Takes at most POLL_EXPOSURES that are due, so that the host is heard in between; returns the
 * device time at which to call again (past where more is due), or -1 when nothing runs. */
int64_t device_poll(struct device *d);

#endif
