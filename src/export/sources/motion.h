/*
 * Equations of motion in generalized coordinates q with velocities v, parameters p and inputs u:
 *
 *     qd = v
 *     M(q, p) vd + h = -dV/dq + F(q, p) - D(q, p) v + B(q, p) u
 *     h_i = sum over j, k of (dM_ij/dq_k - dM_jk/dq_i / 2) v_j v_k
 *
 * The inputs of a point are p, the starts of q and v, u; its states are q and v. A position is r(q, p) + w^T q with
 * whole numbers w, so that an angle may go around; its velocity and acceleration are exact derivatives. The functions
 * M, V, F, D, B and r were learned: each is a sum of products of sines, cosines and powers, a dictionary, to which a
 * network may add. Another network may add forces that depend on q, p, v and u.
 */
#ifndef MOTION_H
#define MOTION_H

#include "jets.h"
#include "model.h"

/* A column of a dictionary, of (q, p): sines and cosines of its multiples, or powers of (x - middle) * scale. */
typedef struct {
    bool angle;
    double middle;
    double scale;
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
    double value;
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
    double mean;
    double scale; /* what a difference from the mean is multiplied by */
} TermColumn;

typedef enum {
    TERM_TANH,
    TERM_SIGMOID,
    TERM_RELU,
    TERM_GELU,
    TERM_SILU,
    TERM_SINE,
    TERM_IDENTITY
} TermActivation;

typedef struct {
    size_t inputs;
    size_t outputs;
    const double *weights; /* column by column */
    const double *bias;
    TermActivation activation;
} TermLayer;

typedef struct {
    size_t of; /* which function */
    double mean;
    double scale;
} TermOutput;

typedef struct {
    size_t column_count;
    const TermColumn *columns;
    size_t layer_count;
    const TermLayer *layers;
    size_t output_count;
    const TermOutput *outputs;
} NetworkTerm;

/* What an output shows of the motion. */
typedef enum {
    SHOWN_POSITION,
    SHOWN_VELOCITY,
    SHOWN_ACCELERATION,
    SHOWN_KINETIC_ENERGY,
    SHOWN_POTENTIAL_ENERGY
} ShownKind;

typedef struct {
    ShownKind kind;
    size_t position; /* which one, or whose derivative */
} Shown;

/* Where the law has what: the lower triangle of M row by row, V, F, D row by row, B row by row. */
enum {
    LAW_POTENTIAL = COORDINATE_COUNT * (COORDINATE_COUNT + 1) / 2,
    LAW_FORCE = LAW_POTENTIAL + 1,
    LAW_DAMPING = LAW_FORCE + COORDINATE_COUNT,
    LAW_INPUTS = LAW_DAMPING + COORDINATE_COUNT * COORDINATE_COUNT,
    LAW_COUNT = LAW_INPUTS + COORDINATE_COUNT * (INPUT_COUNT - FIRST_DRIVEN)
};

extern const Dictionary model_law;
extern const Dictionary model_positions;
extern const NetworkTerm model_law_network;
extern const NetworkTerm model_positions_network;
extern const NetworkTerm model_forces_network; /* of (q, p, v, u) */
extern const double model_windings[POSITION_SIZE * COORDINATE_COUNT]; /* w of each position */
extern const Shown model_shown[OUTPUT_COUNT];
extern const double model_solver_step; /* s; of the classical Runge-Kutta method at most */

/* Columns of the forces' network. */
enum { FORCE_COLUMNS = DICTIONARY_COLUMNS + COORDINATE_COUNT + INPUT_COUNT - FIRST_DRIVEN };

/* Working memory of an evaluation in one kind of numbers, with jets of them along the motion. */
#define MOTION_WORK(Name, Number, Along)                              \
    typedef struct {                                                  \
        Number point[COLUMN_COUNT];                                   \
        Number results[RESULT_COUNT];                                 \
        Number columns[DICTIONARY_COLUMNS];                           \
        Number force_columns[FORCE_COLUMNS];                          \
        Number atoms[ATOM_COUNT];                                     \
        Number slopes[ATOM_COUNT];                                    \
        Number network[2 * (1 + COORDINATE_COUNT) * NETWORK_WIDTH];   \
        Number law[LAW_COUNT];                                        \
        Number gradient[LAW_COUNT * COORDINATE_COUNT];                \
        Number factors[COORDINATE_COUNT * COORDINATE_COUNT];          \
        Number accelerations[COORDINATE_COUNT];                       \
        Along along[DICTIONARY_COLUMNS];                              \
        Along along_atoms[ATOM_COUNT];                                \
        Along along_slopes[ATOM_COUNT];                               \
        Along along_network[2 * NETWORK_WIDTH];                       \
        Along positions[POSITION_SIZE];                               \
    } Name

MOTION_WORK(RealWork, double, Jet);
MOTION_WORK(JetWork, Jet, Nested);

enum { MOTION_STAGES = 7 }; /* of the method of Dormand and Prince */

/* Working memory of one evaluation at a time. */
typedef struct {
    RealWork real;
    JetWork jet;
    /* of a step: columns at a stage, the rates of the states at each stage, and the states before */
    double stage[COLUMN_COUNT];
    double rates[MOTION_STAGES][STATE_COUNT];
    double before[STATE_COUNT];
} Scratch;

typedef enum {
    ADVANCE_DONE,
    ADVANCE_NOT_FINITE,    /* the mass matrix is not positive definite, or the motion diverged */
    ADVANCE_TOO_MANY_STEPS /* more than ten million */
} Advance;

/* What a step of the solver is to do. */
typedef struct {
    double size;                /* s */
    double tolerance;           /* relative to each state and to its nominal value; zero for steps of fixed size */
    const double *rates;        /* of the inputs at the beginning, per s */
    const double *second_rates; /* per s^2 */
    bool clamp;                 /* whether inputs are clamped to their ranges on the way */
} Step;

/*
 * Integrates the states of a point: in equal steps of the classical Runge-Kutta method, none longer than
 * model_solver_step, or, with a tolerance, in steps of the method of Dormand and Prince, whose local error is at most
 * the tolerance. If that fails, the states are as before, and *after is how far it came, in s.
 */
Advance motion_advance(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, double *after);

#endif
