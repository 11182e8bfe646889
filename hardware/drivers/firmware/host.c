/* The device on a workstation: behind a pseudo-terminal, looking at a picture of its own.
 *
 *   device [--fast] [--reset-after FRAMES] [--stall-after FRAMES] [--backlog MS]
 *                        prints the terminal's path, serves until its standard input closes
 *   device --encode      hex lines of type, tag and payload -> hex lines as on the wire
 *   device --decode      the other way; a broken line gives an empty one
 */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE

#include "device.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static struct device device;
static int line = -1;
static bool fast;
static int64_t virtual_ns;

static int64_t now_ns(void)
{
    struct timespec now;
    if (fast)
        return virtual_ns;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static uint8_t waiting[1 << 16];
static size_t n_waiting;

static void flush(void)
{
    while (n_waiting) {
        ssize_t n = write(line, waiting, n_waiting);
        if (n <= 0)
            return;
        n_waiting -= (size_t)n;
        memmove(waiting, waiting + n, n_waiting);
    }
}

static bool send_bytes(const uint8_t *data, size_t size, bool measurement)
{
    size_t reserved = measurement ? 2 * (FRAME_ENCODED_MOST + 1) : 0; /* for answers */
    flush();
    if (n_waiting + size + reserved > sizeof waiting) /* answers may stand in what is reserved */
        return false;
    memcpy(waiting + n_waiting, data, size);
    n_waiting += size;
    flush();
    return true;
}

/* Cell i shines (37 i + 11 detector) mod 97 electrons; the last half of the detectors sees the
 * complements when the set is complementary. The gain doubles the counts. */
static uint8_t expose(const struct patterns *p, uint32_t exposure, const struct shutter *shutter,
                      uint8_t gain, double integration_time_s, int32_t *counts)
{
    const struct platform *platform = device.platform;
    const int64_t top = ((int64_t)1 << platform->adc_bits) - 1;
    uint8_t flags = 0;
    (void)shutter, (void)integration_time_s;
    for (uint32_t d = 0; d < platform->detectors; d++) {
        bool other = p->mode == MODE_COMPLEMENTARY && d >= platform->detectors / 2;
        uint32_t eye = other ? d - platform->detectors / 2 : d;
        int64_t sum = 0;
        for (uint32_t cell = 0; cell < p->rows * p->columns; cell++)
            if (patterns_lit(p, exposure, cell) != other)
                sum += (37 * cell + 11 * eye) % 97;
        sum = (sum << gain) + 100;
        if (sum > top)
            flags |= FLAG_SATURATED;
        counts[d] = (int32_t)(sum > top ? top : sum);
    }
    return flags;
}

static double electrons_per_count(uint8_t gain) { return 1.0 / (1 << gain); }
static double offset_counts(uint8_t gain) { return (void)gain, 100.0; }

static struct platform platform = {
    .name = "ugv reference firmware 1",
    .adc_bits = 16,
    .detectors = 2,
    .gains = 3,
    .min_integration_time_s = 1e-6,
    .max_integration_time_s = 1.0,
    .readout_time_s = 2e-6,
    .backlog_ns = 2000000000, /* a workstation may be busy with other things */
    .now_ns = now_ns,
    .send = send_bytes,
    .expose = expose,
    .electrons_per_count = electrons_per_count,
    .offset_counts = offset_counts,
};

static int open_line(void)
{
    struct termios raw;
    int slave;
    line = posix_openpt(O_RDWR | O_NOCTTY);
    if (line < 0 || grantpt(line) || unlockpt(line))
        return -1;
    /* Kept open, so that the line outlives a host that hangs up. */
    slave = open(ptsname(line), O_RDWR | O_NOCTTY);
    if (slave < 0 || tcgetattr(slave, &raw))
        return -1;
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(line, F_SETFL, O_NONBLOCK);
    puts(ptsname(line));
    fflush(stdout);
    return 0;
}

/* Play what is due. Fast: the device's time leaps to each exposure, and stands still until the
 * line has taken the last frame. */
static int64_t play(uint64_t until_frame)
{
    int64_t due = -1;
    for (uint32_t n = 0; n < POLL_EXPOSURES; n++) {
        if (device.state == STATE_RUNNING && device.frames >= until_frame)
            return -1;
        if (fast && n_waiting)
            return -1;
        due = device_poll(&device);
        if (!fast || due < 0)
            return due;
        if (due > virtual_ns)
            virtual_ns = due;
    }
    return due;
}

static int serve(uint64_t reset_after, uint64_t stall_after)
{
    if (open_line()) {
        perror("pseudo-terminal");
        return 1;
    }
    device_start(&device, &platform);
    for (;;) {
        int64_t due = play(reset_after < stall_after ? reset_after : stall_after);
        if (device.frames >= reset_after) {
            reset_after = UINT64_MAX;
            virtual_ns = 0;
            device_start(&device, &platform);
        }
        int64_t wait_ms = due < 0 ? 100 : (due - now_ns()) / 1000000;
        struct pollfd ends[2] = {{line, POLLIN | (n_waiting ? POLLOUT : 0), 0},
                                 {STDIN_FILENO, POLLIN, 0}};
        poll(ends, 2, wait_ms < 0 ? 0 : (int)wait_ms);
        if (ends[1].revents) {
            char ignored[64];
            if (read(STDIN_FILENO, ignored, sizeof ignored) <= 0)
                return 0;
        }
        if (ends[0].revents & POLLIN) {
            uint8_t data[4096];
            ssize_t n = read(line, data, sizeof data);
            if (n > 0)
                device_receive(&device, data, (size_t)n);
        }
        flush();
    }
}

/* Hex lines, for the test vectors. */
static int translate(bool encoding)
{
    static char text[4 * FRAME_ENCODED_MOST];
    static uint8_t in[2 * FRAME_ENCODED_MOST], out[2 * FRAME_ENCODED_MOST];
    while (fgets(text, sizeof text, stdin)) {
        size_t size = strspn(text, "0123456789abcdef") / 2, length;
        for (size_t i = 0; i < size; i++) {
            char byte[3] = {text[2 * i], text[2 * i + 1], 0};
            in[i] = (uint8_t)strtoul(byte, 0, 16);
        }
        if (encoding) {
            uint32_t crc = crc32_update(0, in, size);
            for (int i = 0; i < 4; i++)
                in[size++] = (uint8_t)(crc >> (8 * i));
            length = cobs_encode(in, size, out);
        } else {
            length = size > 1 ? cobs_decode(in, size - 1, out) : 0;
            uint32_t crc = 0;
            for (size_t i = 0; length >= 6 && i < 4; i++)
                crc |= (uint32_t)out[length - 4 + i] << (8 * i);
            length = length >= 6 && crc32_update(0, out, length - 4) == crc ? length - 4 : 0;
        }
        for (size_t i = 0; i < length; i++)
            printf("%02x", out[i]);
        putchar('\n');
    }
    return 0;
}

int main(int n, char **arguments)
{
    uint64_t reset_after = UINT64_MAX, stall_after = UINT64_MAX;
    for (int i = 1; i < n; i++) {
        if (!strcmp(arguments[i], "--encode") || !strcmp(arguments[i], "--decode"))
            return translate(arguments[i][2] == 'e');
        if (!strcmp(arguments[i], "--fast"))
            fast = true;
        else if (!strcmp(arguments[i], "--reset-after") && i + 1 < n)
            reset_after = strtoull(arguments[++i], 0, 10);
        else if (!strcmp(arguments[i], "--stall-after") && i + 1 < n)
            stall_after = strtoull(arguments[++i], 0, 10);
        else if (!strcmp(arguments[i], "--backlog") && i + 1 < n)
            platform.backlog_ns = (int64_t)strtoul(arguments[++i], 0, 10) * 1000000;
        else {
            fprintf(stderr, "usage: device [--fast] [--reset-after FRAMES] [--stall-after FRAMES] "
                            "[--backlog MS] | --encode | --decode\n");
            return 2;
        }
    }
    return serve(reset_after, stall_after);
}
