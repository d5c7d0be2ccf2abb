/*
 * Functions as a tape: a list of operations on registers, the numbers of a working memory. The first registers are the
 * inputs, followed by zero and one. A tape omits terms that are zero everywhere, and computes repeated terms once.
 * Terms of fixed inputs alone are computed when these inputs change. The template tape_run.h runs tapes.
 *
 * Cost of a run, in multiplications, additions and divisions:
 *
 *     6 (k - 1)    for cosines and sines of 1 to k times an angle, besides one sine and one cosine,
 *     2            for each product that is added,
 *     2 BLOCK c    for a block of a matrix with c columns,
 *     2 BLOCK      for a block of a scalar product,
 *     BLOCK        for a block of products,
 *     BLOCK activations    for a block of nodes, with their slopes at most 110 operations of activation.c each,
 *     1            for a quotient, reciprocal or minimum,
 *     a (6 m + 52) for a table of a arguments with m numbers at a node, besides the search of its knots,
 *
 * and a function call for any other operation.
 */
#ifndef TAPE_H
#define TAPE_H

#include "activation.h"
#include "jets.h"
#include "model_data.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef enum {
    TAPE_HARMONICS,   /* cosines of 1, ..., count times a, then the sines */
    TAPE_PRODUCT,     /* a b + c */
    TAPE_PRODUCTS,    /* the sum of count products a[i] b[i], and c */
    TAPE_MATRIX,      /* W a + c, count blocks of rows; b is the number of columns, c is a block or the register of zero */
    TAPE_DOT,         /* w^T a + c, of count blocks */
    TAPE_ACTIVATION,  /* count blocks f(a), followed by f'(a) if b is not 0 */
    TAPE_BLOCKS,      /* count blocks of products a[i] b[i] */
    TAPE_RECIPROCAL,  /* 1 / a, NaN where a is not positive */
    TAPE_CALL,        /* f(a) */
    TAPE_COMBINE,     /* f(a, b) */
    TAPE_LOOKUP       /* a table at a and b */
} OperationKind;

typedef struct {
    uint8_t kind;
    uint8_t function; /* an Activation, Function or Combination */
    RegisterIndex a;
    RegisterIndex b;
    RegisterIndex c;
    RegisterIndex to;
    RegisterIndex count;
    uint32_t data; /* first block of weights, or the table */
} Operation;

typedef struct {
    RegisterIndex of;
    Real value;
} Constant;

typedef struct {
    size_t inputs;
    size_t first_fixed; /* among the inputs */
    size_t fixed_count;
    size_t constant_count;
    const Constant *constants;
    const Real *weights; /* of each block of rows, column by column */
    size_t counts[3];
    /* operations on fixed inputs alone; all others; those of results on demand */
    const Operation *operations[3];
    const RegisterIndex *results;
} Tape;

#endif
