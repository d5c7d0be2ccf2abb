/*
 * Functions that were learned: sums of products of sines, cosines and powers of some columns, a dictionary, and
 * networks that add to them. They are evaluated by the templates dictionary.h and network_term.h.
 */
#ifndef FUNCTIONS_H
#define FUNCTIONS_H

#include "activation.h"
#include "blocks.h"
#include "real.h"
#include <stdbool.h>
#include <stddef.h>

/* A column of a dictionary: sines and cosines of its multiples, or powers of (x - middle) * scale. */
typedef struct {
    bool angle;
    Real middle;
    Real scale;
    size_t orders; /* multiples or powers 1, 2, ..., orders */
} DictionaryColumn;

/* A product: how many factors it has, and how many outputs have it. */
typedef struct {
    size_t factors;
    size_t coefficients;
} Product;

typedef struct {
    size_t column;
    size_t atom; /* which function of all columns' */
} Factor;

typedef struct {
    size_t output;
    Real value;
} Coefficient;

/* Factors and coefficients are listed product by product. */
typedef struct {
    size_t outputs;
    size_t product_count;
    const DictionaryColumn *columns;
    const Product *products;
    const Factor *factors;
    const Coefficient *coefficients;
} Dictionary;

/* A network that adds to functions of some columns; none if it has no columns, layers and outputs. */
typedef enum { TERM_PLAIN, TERM_OF_SINE, TERM_OF_COSINE } TermColumnKind;

typedef struct {
    size_t of; /* which column */
    TermColumnKind kind;
    Real mean;
    Real scale; /* what a difference from the mean is multiplied by */
} TermColumn;

/*
 * A layer, the activation of W x + b. Its rows are padded with zeros to whole blocks of BLOCK rows;
 * weights[(block * inputs + column) * BLOCK + row], so that a product reads them from first to last.
 */
typedef struct {
    size_t inputs;
    size_t rows;
    const Real *weights;
    const Real *bias;
    Activation activation;
} TermLayer;

typedef struct {
    size_t of; /* which function */
    Real mean;
    Real scale;
} TermOutput;

typedef struct {
    size_t column_count;
    const TermColumn *columns;
    size_t layer_count;
    const TermLayer *layers;
    size_t output_count;
    const TermOutput *outputs;
} NetworkTerm;

#endif
