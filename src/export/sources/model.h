/*
 * The surrogate as data. model_data.h has the sizes, model_data.c the numbers; both are generated, everything else is
 * the same in every FMU.
 */
#ifndef MODEL_H
#define MODEL_H

#include "model_data.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What the value of a variable is. */
typedef enum {
    VARIABLE_COLUMN,
    VARIABLE_OUTPUT,
    VARIABLE_DOMAIN_POLICY,
    VARIABLE_IN_DOMAIN,
    VARIABLE_DOMAIN_DISTANCE,
    VARIABLE_TIME,  /* the independent variable of a surrogate without a time column */
    VARIABLE_ARRAY, /* of outputs; not part of this code */
    VARIABLE_BOUND
} Quantity;

/* A variable; its value reference is its position in model_variables. */
typedef struct {
    const char *name;
    Quantity quantity;
    size_t index; /* of the column, or of the output that the bound is of */
    bool only_fmi3;
} Variable;

/* What an input column of the network is to a host. */
typedef enum { ROLE_FIXED_PARAMETER, ROLE_TUNABLE_PARAMETER, ROLE_TIME, ROLE_INPUT } Role;

/* An input column of the network, in the unit that modelDescription.xml gives the variable of that name. */
typedef struct {
    const char *name;
    Role role;
    double start;
    double min;   /* training range */
    double max;
    double width; /* what distances from the range are relative to */
    double mean;  /* (x - mean) / scale goes into the network */
    double scale;
} Column;

/* An output column: mean + scale * (what comes out of the network). */
typedef struct {
    double mean;
    double scale;
    double bound; /* error bound, if there is a variable for it */
} Output;

typedef enum {
    ACTIVATION_TANH,
    ACTIVATION_SIGMOID,
    ACTIVATION_RELU,
    ACTIVATION_GELU,
    ACTIVATION_SILU,
    ACTIVATION_SINE,
    ACTIVATION_IDENTITY
} Activation;

/*
 * A hidden layer, the activation of W x + b. The rows of W are padded with zeros to whole blocks of BLOCK rows;
 * weights[(block * inputs + column) * BLOCK + row], so that a product reads them from first to last.
 */
typedef struct {
    size_t inputs;
    size_t blocks;
    const double *weights;
    const double *bias;
    Activation activation;
} Layer;

extern const char model_token[];       /* guid in FMI 2.0, instantiationToken in FMI 3.0 */
extern const char model_description[]; /* for the log */
extern const double model_time_step;   /* s; what hosts are told to step by */
extern const Variable model_variables[VARIABLE_COUNT];
extern const Column model_columns[COLUMN_COUNT];
extern const Output model_outputs[OUTPUT_COUNT];
extern const size_t model_hidden_count;
extern const Layer model_hidden[];
/* The last layer, row by row, with the columns padded with zeros to LAST_COLUMNS. */
extern const double model_last_weights[OUTPUT_COUNT * LAST_COLUMNS];
extern const double model_last_bias[OUTPUT_COUNT];

#endif
