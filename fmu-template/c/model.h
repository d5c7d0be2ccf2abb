/*
 * The surrogate as data. model_data.h has the sizes, model_data.c the numbers; both are generated, everything else is
 * the same in every FMU of its kind. What the numbers of a model mean is in the headers maps.h, motion.h, state_space.h
 * or discrete.h, and in those that they include.
 */
#ifndef MODEL_H
#define MODEL_H

#include "model_data.h"
#include "real.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What the value of a variable is. */
typedef enum {
    VARIABLE_COLUMN,
    VARIABLE_OUTPUT,
    VARIABLE_STATE,
    VARIABLE_DERIVATIVE, /* of a state with respect to time */
    VARIABLE_DOMAIN_POLICY,
    VARIABLE_IN_DOMAIN,
    VARIABLE_DOMAIN_DISTANCE,
    VARIABLE_TIME,  /* the independent variable of a surrogate without a time column */
    VARIABLE_ARRAY, /* of outputs; not part of this code */
    VARIABLE_BOUND,
    VARIABLE_MEASURED,    /* the measured value of an output of a discrete-time model */
    VARIABLE_USE_MEASURED /* whether measured values are used */
} Quantity;

/* A variable; its value reference is its position in model_variables. */
typedef struct {
    const char *name;
    Quantity quantity;
    size_t index; /* of the input, output or state that it is or belongs to */
    bool only_fmi3;
} Variable;

/* What a column is to a host. */
typedef enum {
    ROLE_FIXED_PARAMETER,
    ROLE_TUNABLE_PARAMETER,
    ROLE_TIME,
    ROLE_INPUT,
    /* a fixed parameter: what a state, or what is remembered, is until the simulation runs; in the same order */
    ROLE_START,
    ROLE_STATE
} Role;

/*
 * A column of a point: an input of the surrogate or, after all inputs, a state. In the unit that modelDescription.xml
 * gives the variable of that name.
 */
typedef struct {
    const char *name;
    Role role;
    double start;
    double min; /* training range; infinite where every number is as good */
    double max;
    double width;       /* what distances from the range are relative to */
    double nominal;     /* of a state: its typical magnitude */
    size_t value_count; /* if it is not zero, only these values are valid */
    const double *values;
} Column;

extern const char model_token[];       /* guid in FMI 2.0, instantiationToken in FMI 3.0 */
extern const char model_description[]; /* for the log */
extern const double model_time_step;   /* s; what hosts are told to step by */
extern const Variable model_variables[VARIABLE_COUNT];
extern const Column model_columns[NAMED_COUNT];
/* Error bounds, where there are variables for them: at times since the start, between which they are linear; one, 0, if they do not grow. */
extern const double model_bound_times[BOUND_TIME_COUNT];
extern const double model_bounds[BOUND_TIME_COUNT * OUTPUT_COUNT];

#if MODEL_HAS_COVER
/*
 * Where training data are: a point is near them if in all of these columns it is at most so far away from one of the
 * centres, relative to the ranges.
 */
extern const double model_cover_radius;
extern const uint32_t model_cover_columns[COVER_COLUMN_COUNT];
extern const float model_centres[COVER_COUNT * COVER_COLUMN_COUNT];
#endif

/* Position of the column's value that is nearest; of two the first. */
static inline size_t nearest(const Column *column, double x)
{
    size_t best = 0;
    for (size_t i = 1; i < column->value_count; i++) {
        const double value = column->values[i];
        const double before = column->values[best];
        /* by the middle between the two: far away, distances are equal up to rounding */
        const double middle = before + 0.5 * (value - before);
        if (value > before ? x > middle : x < middle) {
            best = i;
        }
    }
    return best;
}

/* Least and largest of the valid values around this one. */
static inline double least_valid(const Column *column, double value)
{
    return column->value_count > 0 ? column->values[nearest(column, value)] : column->min;
}

static inline double largest_valid(const Column *column, double value)
{
    return column->value_count > 0 ? column->values[nearest(column, value)] : column->max;
}

/* The nearest valid value. */
static inline double clamped(const Column *column, double value)
{
    const double min = least_valid(column, value);
    const double max = largest_valid(column, value);
    if (value < min) {
        return min;
    }
    return value > max ? max : value;
}

/* An input in the course of a step. */
typedef struct {
    Real value; /* at the beginning, with its rates */
    Real rate;
    Real second_rate;
    Real min; /* what it is clamped to; infinite if it is not */
    Real max;
    Real ends[2]; /* its range, which it is off by rounding at most when it goes to an end of it */
    Real rounding;
} Drive;

/* The input, `since` seconds after the beginning. */
static inline Real driven(const Drive *drive, Real since)
{
    const Real value = drive->value + since * (drive->rate + R(0.5) * since * drive->second_rate);
    /* beyond the end of a range a formula may have no value */
    if (value < drive->ends[0] && value >= drive->ends[0] - drive->rounding) {
        return drive->ends[0];
    }
    if (value > drive->ends[1] && value <= drive->ends[1] + drive->rounding) {
        return drive->ends[1];
    }
    if (value < drive->min) {
        return drive->min;
    }
    return value > drive->max ? drive->max : value;
}

#endif
