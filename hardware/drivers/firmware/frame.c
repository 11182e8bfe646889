#include "frame.h"

uint32_t crc32_update(uint32_t crc, const uint8_t *data, size_t size)
{
    /* Reflected polynomial of IEEE 802.3, four bits at a time. */
    static const uint32_t table[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u,
        0x4db26158u, 0x5005713cu, 0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu,
        0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        crc = table[crc & 15u] ^ (crc >> 4);
        crc = table[crc & 15u] ^ (crc >> 4);
    }
    return ~crc;
}

size_t cobs_encode(const uint8_t *data, size_t size, uint8_t *out)
{
    size_t code_at = 0, to = 1;
    uint8_t code = 1;
    for (size_t i = 0; i < size; i++) {
        if (data[i] != 0) {
            out[to++] = data[i];
            code++;
        }
        if (data[i] == 0 || (code == 255 && i + 1 < size)) {
            out[code_at] = code;
            code_at = to++;
            code = 1;
        }
    }
    out[code_at] = code;
    out[to++] = 0;
    return to;
}

size_t cobs_decode(const uint8_t *data, size_t size, uint8_t *out)
{
    size_t from = 0, to = 0;
    while (from < size) {
        uint8_t code = data[from++];
        if (code == 0 || from + code - 1u > size)
            return 0;
        for (uint8_t i = 1; i < code; i++) {
            if (data[from] == 0)
                return 0;
            out[to++] = data[from++];
        }
        if (code < 255 && from < size)
            out[to++] = 0;
    }
    return to;
}
