/* Frames on the wire: COBS between zero bytes, CRC-32 at the end (PROTOCOL.md, section 2). */
#ifndef FRAME_H
#define FRAME_H

#include <stddef.h>
#include <stdint.h>

#define FRAME_MOST 4096u /* type, tag, payload, CRC-32 */
#define FRAME_ENCODED_MOST (FRAME_MOST + (FRAME_MOST + 253u) / 254u)

uint32_t crc32_update(uint32_t crc, const uint8_t *data, size_t size); /* start with 0 */

/* Stuff size bytes; returns the length, the closing zero included. out holds
 * FRAME_ENCODED_MOST + 1. */
size_t cobs_encode(const uint8_t *data, size_t size, uint8_t *out);

/* Undo it, in place too; returns the length, or 0 where it is broken. */
size_t cobs_decode(const uint8_t *data, size_t size, uint8_t *out);

#endif
