#include "patterns.h"

#include "frame.h"

static bool power_of_two(uint32_t n) { return n != 0 && (n & (n - 1)) == 0; }

/* Sign changes along row i of the natural-order n x n Hadamard matrix: the reversed bits of i are
 * the Gray code of that number. */
static uint32_t sign_changes(uint32_t i, uint32_t n)
{
    uint32_t gray = 0;
    for (uint32_t bit = 1; bit < n; bit <<= 1, i >>= 1)
        gray = gray << 1 | (i & 1u);
    for (uint32_t shift = 1; shift < 32; shift <<= 1)
        gray ^= gray >> shift;
    return gray;
}

static uint32_t key(const struct patterns *p, uint32_t i)
{
    if (p->order == ORDER_SEQUENCY || p->order == ORDER_INTERLEAVED)
        return sign_changes(i / p->columns, p->rows) + sign_changes(i % p->columns, p->columns);
    if (p->order == ORDER_WALSH)
        return sign_changes(i, p->rows * p->columns);
    return i;
}

/* Fill the index in ascending order of the key, ties by index: a counting sort. */
static void sort_rows(struct patterns *p)
{
    static uint32_t start[MOST_CELLS + 1];
    uint32_t cells = p->rows * p->columns, sum = 0;
    for (uint32_t k = 0; k <= cells; k++)
        start[k] = 0;
    for (uint32_t i = 0; i < cells; i++)
        start[key(p, i)]++;
    for (uint32_t k = 0; k < cells; k++) {
        uint32_t here = start[k];
        start[k] = sum;
        sum += here;
    }
    for (uint32_t i = 0; i < cells; i++)
        p->index[start[key(p, i)]++] = i;
}

/* Low and high sequency in turn: at place k the row of rank k times a step, modulo the count. */
static void interleave(struct patterns *p)
{
    static uint32_t ranked[MOST_CELLS];
    uint32_t step = (618 * p->count + 500) / 1000;
    for (step = step ? step : 1;; step++) {
        uint32_t a = step, b = p->count;
        while (b) {
            uint32_t rest = a % b;
            a = b;
            b = rest;
        }
        if (a == 1)
            break;
    }
    for (uint32_t k = 0; k < p->count; k++)
        ranked[k] = p->index[k];
    for (uint32_t k = 0, rank = 0; k < p->count; k++, rank = (rank + step) % p->count)
        p->index[k] = ranked[rank];
}

const char *patterns_set(struct patterns *p, uint32_t rows, uint32_t columns, uint32_t count,
                         uint8_t order, uint8_t mode)
{
    if (!power_of_two(rows) || !power_of_two(columns) || rows > MOST_CELLS / columns)
        return "rows, columns: powers of two are expected, and no more cells than I have";
    if (count < 1 || count > rows * columns)
        return "count: from 1 to the number of cells is expected";
    if (order != ORDER_UPLOADED && (order >= 16 || !(KNOWN_ORDERS >> order & 1u)))
        return "order: not known here, upload it";
    if (mode >= MODES)
        return "mode: not known here";
    uint32_t exposures = mode == MODE_DIFFERENTIAL ? 2 * count
                         : mode == MODE_REFERENCE  ? count + 2
                                                   : count;
    uint32_t row_bytes = (rows * columns + 7) / 8;
    if (order == ORDER_UPLOADED && exposures > MOST_TABLE_BYTES / row_bytes)
        return "the table is larger than my memory";
    p->kept = order == ORDER_UPLOADED && p->order == ORDER_UPLOADED &&
              p->size == exposures * row_bytes && p->loaded == p->size;
    p->rows = rows;
    p->columns = columns;
    p->count = count;
    p->order = order;
    p->mode = mode;
    p->exposures = exposures;
    p->size = exposures * row_bytes;
    p->loaded = order == ORDER_UPLOADED && !p->kept ? 0 : p->size;
    if (order != ORDER_UPLOADED)
        sort_rows(p);
    if (order == ORDER_INTERLEAVED)
        interleave(p);
    return 0;
}

bool patterns_lit(const struct patterns *p, uint32_t exposure, uint32_t cell)
{
    if (p->order == ORDER_UPLOADED) {
        uint32_t row_bytes = (p->rows * p->columns + 7) / 8;
        return p->bits[exposure * row_bytes + cell / 8] >> (7 - cell % 8) & 1u;
    }
    uint32_t row;
    bool inverted = false;
    switch (p->mode) {
    case MODE_DIFFERENTIAL:
        row = p->index[exposure / 2];
        inverted = exposure % 2;
        break;
    case MODE_REFERENCE:
        row = exposure < 2 ? 0 : p->index[exposure - 2];
        inverted = exposure == 1;
        break;
    default:
        row = p->index[exposure];
        inverted = p->mode == MODE_S_MATRIX;
    }
    uint32_t parity = row & cell;
    for (uint32_t shift = 16; shift; shift >>= 1)
        parity ^= parity >> shift;
    return (parity & 1u) == inverted;
}

uint32_t patterns_crc(const struct patterns *p)
{
    if (p->order == ORDER_UPLOADED)
        return crc32_update(0, p->bits, p->loaded);
    uint32_t crc = 0, cells = p->rows * p->columns;
    for (uint32_t exposure = 0; exposure < p->exposures; exposure++)
        for (uint32_t cell = 0; cell < cells; cell += 8) {
            uint8_t byte = 0;
            for (uint32_t bit = 0; bit < 8; bit++)
                if (cell + bit < cells && patterns_lit(p, exposure, cell + bit))
                    byte |= (uint8_t)(0x80u >> bit);
            crc = crc32_update(crc, &byte, 1);
        }
    return crc;
}
