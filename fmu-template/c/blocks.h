/*
 * Template without an include guard: products of a matrix, whose rows are in blocks of BLOCK, with a vector. Each block
 * goes column by column, so that no sum waits for another. Define before inclusion: NUMBER, the type of numbers, and
 * OF(name), the name of a function of them.
 */

#include "clones.h"

/* y += W x for a block of rows, a few columns at a time: few enough for the registers of any processor. */
static INLINED void OF(add_block)(const Real *restrict w, size_t columns, const NUMBER *restrict x, NUMBER *restrict y)
{
    size_t column = 0;
    for (; column + 4 <= columns; column += 4, w += 4 * BLOCK) {
        for (size_t row = 0; row < BLOCK; row++) {
            const NUMBER a = OF(scaled)(x[column], w[row]);
            const NUMBER b = OF(scaled)(x[column + 1], w[BLOCK + row]);
            const NUMBER c = OF(scaled)(x[column + 2], w[2 * BLOCK + row]);
            const NUMBER d = OF(scaled)(x[column + 3], w[3 * BLOCK + row]);
            y[row] = OF(sum)(y[row], OF(sum)(OF(sum)(a, b), OF(sum)(c, d)));
        }
    }
    for (; column < columns; column++, w += BLOCK) {
        for (size_t row = 0; row < BLOCK; row++) {
            y[row] = OF(sum)(y[row], OF(scaled)(x[column], w[row]));
        }
    }
}
