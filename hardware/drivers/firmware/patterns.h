/* The pattern table: Hadamard patterns by name, or bits as the host sent them (section 5). */
#ifndef PATTERNS_H
#define PATTERNS_H

#include <stdbool.h>
#include <stdint.h>

#ifndef MOST_CELLS
#define MOST_CELLS 4096u
#endif
#ifndef MOST_TABLE_BYTES
#define MOST_TABLE_BYTES (1u << 20)
#endif

enum {
    ORDER_NATURAL = 0,
    ORDER_SEQUENCY = 1,
    ORDER_WALSH = 3,
    ORDER_INTERLEAVED = 9,
    ORDER_UPLOADED = 255
};
enum {
    MODE_DIFFERENTIAL = 0,
    MODE_PLAIN = 1,
    MODE_REFERENCE = 2,
    MODE_S_MATRIX = 3,
    MODE_COMPLEMENTARY = 4,
    MODES = 5
};
#define KNOWN_ORDERS \
    (1u << ORDER_NATURAL | 1u << ORDER_SEQUENCY | 1u << ORDER_WALSH | 1u << ORDER_INTERLEAVED)

struct patterns {
    uint32_t rows, columns, count; /* of the virtual image; Hadamard rows shown */
    uint8_t order, mode;
    uint32_t exposures;    /* patterns shown, without shutters */
    uint32_t size, loaded; /* bytes of the table; of an uploaded one, bytes here */
    bool kept;             /* these are of an earlier Configure: the next upload forgets them */
    uint32_t index[MOST_CELLS];
    uint8_t bits[MOST_TABLE_BYTES];
};

/* Why the parameters are no set that this device can show; NULL where they are. */
const char *patterns_set(struct patterns *p, uint32_t rows, uint32_t columns, uint32_t count,
                         uint8_t order, uint8_t mode);
bool patterns_lit(const struct patterns *p, uint32_t exposure, uint32_t cell);
uint32_t patterns_crc(const struct patterns *p);

#endif
