/*
 * Products of a matrix whose rows are in blocks of BLOCK with a vector: of each block column by column, so that no sum waits
 * for another.
 */
#ifndef BLOCKS_H
#define BLOCKS_H

#include <stddef.h>

#include "activation.h"
#include "clones.h"

/* Columns that are added to a block of rows at a time: few enough for the registers of any processor. */
enum { GROUP = 4 };

/* y += W x for one block of rows. */
static INLINED void add_block(const Real *restrict weights, size_t columns, const Real *restrict x, Real *restrict y)
{
    size_t column = 0;
    for (; column + GROUP <= columns; column += GROUP) {
        const Real *w = weights + column * BLOCK;
        const Real a = x[column];
        const Real b = x[column + 1];
        const Real c = x[column + 2];
        const Real d = x[column + 3];
        for (size_t row = 0; row < BLOCK; row++) {
            y[row] += (w[row] * a + w[BLOCK + row] * b) + (w[2 * BLOCK + row] * c + w[3 * BLOCK + row] * d);
        }
    }
    for (; column < columns; column++) {
        for (size_t row = 0; row < BLOCK; row++) {
            y[row] += weights[column * BLOCK + row] * x[column];
        }
    }
}

#endif
