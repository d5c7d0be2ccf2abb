/*
 * The surrogate as data. model_data.h has the sizes and model_data.c the numbers; both are generated. All other files
 * are the same in every FMU of its kind. maps.h, motion.h, state_space.h or discrete.h, and the headers that they
 * include, explain the numbers of a model.
 */
#ifndef MODEL_H
#define MODEL_H

#include "model_data.h"
#include "real.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Meaning of a variable's value. */
typedef enum {
    VARIABLE_NONE, /* no variable, or an array of outputs, which this code does not have */
    VARIABLE_COLUMN,
    VARIABLE_OUTPUT,
    VARIABLE_STATE,
    VARIABLE_DERIVATIVE, /* derivative of a state with respect to time */
    VARIABLE_DOMAIN_POLICY,
    VARIABLE_IN_DOMAIN,
    VARIABLE_DOMAIN_DISTANCE,
    VARIABLE_TIME, /* the independent variable of a surrogate without a time column */
    VARIABLE_BOUND,
    VARIABLE_MEASURED,    /* measured value of an output of a discrete-time model */
    VARIABLE_USE_MEASURED /* true if measured values are used */
} Quantity;

/* A variable; its value reference is its position in model_variables. The first one is at FIRST_REFERENCE. */
typedef struct {
    const char *name;
    Quantity quantity;
    size_t index; /* of the input, output or state that it is or belongs to */
    bool only_fmi3;
} Variable;

/* Role of a column for a host. */
typedef enum {
    ROLE_FIXED_PARAMETER,
    ROLE_TUNABLE_PARAMETER,
    ROLE_TIME,
    ROLE_INPUT,
    /* fixed parameters that define states or memory until the simulation runs; in the same order */
    ROLE_START,
    ROLE_STATE
} Role;

/*
 * A column of a point: an input of the surrogate or, after all inputs, a state. Its unit is that of the variable of
 * this name in modelDescription.xml.
 */
typedef struct {
    const char *name;
    Role role;
    double start;
    double min; /* training range; infinite if any number is valid */
    double max;
    double width;       /* scale of distances from the range */
    double nominal;     /* typical magnitude of a state */
    size_t value_count; /* if not zero, only these values are valid */
    const double *values;
} Column;

extern const char model_token[];       /* guid in FMI 2.0, instantiationToken in FMI 3.0 */
extern const char model_description[]; /* for the log */
extern const double model_time_step;   /* s; step size suggested to hosts */
extern const Variable model_variables[REFERENCE_COUNT];
extern const Column model_columns[NAMED_COUNT];
/* Error bounds, for variables that show them: at times since the start, and linear between them; only at time 0 if they do not grow. */
extern const double model_bound_times[BOUND_TIME_COUNT];
extern const double model_bounds[BOUND_TIME_COUNT * OUTPUT_COUNT];

#if MODEL_HAS_COVER
/*
 * Where training data are: a point is near them if all these columns are within the radius of one of the centers,
 * relative to the ranges.
 */
extern const double model_cover_radius;
extern const uint32_t model_cover_columns[COVER_COLUMN_COUNT];
extern const float model_centres[COVER_COUNT * COVER_COLUMN_COUNT];
#endif

/* Returns the position of the column's nearest value; on a tie, of the first one. */
static inline size_t nearest(const Column *column, double x)
{
    size_t best = 0;
    for (size_t i = 1; i < column->value_count; i++) {
        const double value = column->values[i];
        const double before = column->values[best];
        /* compared with the midpoint, because far away distances are equal up to rounding */
        const double middle = before + 0.5 * (value - before);
        if (value > before ? x > middle : x < middle) {
            best = i;
        }
    }
    return best;
}

/* Return the least and the largest of the valid values around this one. */
static inline double least_valid(const Column *column, double value)
{
    return column->value_count > 0 ? column->values[nearest(column, value)] : column->min;
}

static inline double largest_valid(const Column *column, double value)
{
    return column->value_count > 0 ? column->values[nearest(column, value)] : column->max;
}

/* Returns the nearest valid value. */
static inline double clamped(const Column *column, double value)
{
    const double min = least_valid(column, value);
    const double max = largest_valid(column, value);
    if (value < min) {
        return min;
    }
    return value > max ? max : value;
}

/* An input during a step. */
typedef struct {
    Real value; /* at the beginning, with its rates */
    Real rate;
    Real second_rate;
    Real min; /* limits of clamping; infinite without */
    Real max;
    Real ends[2]; /* its range, which it exceeds by rounding at most when it reaches an end */
    Real rounding;
} Drive;

/* Returns the input `since` seconds after the beginning. */
static inline Real driven(const Drive *drive, Real since)
{
    const Real value = drive->value + since * (drive->rate + R(0.5) * since * drive->second_rate);
    /* beyond the end of a range, a formula may have no value */
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
