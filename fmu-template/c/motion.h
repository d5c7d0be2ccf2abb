/*
 * Equations of motion in generalized coordinates q with velocities v, parameters p and inputs u:
 *
 *     qd = v
 *     M(q, p) vd + h = -dV/dq + F(q, p) - D(q, p) v + B(q, p) e
 *     h_i = sum over j, k of (dM_ij/dq_k - dM_jk/dq_i / 2) v_j v_k
 *
 * The efforts e are formulas of parameters, inputs, and of positions r(q, p) + w^T q and their rates. A driver may
 * prescribe the acceleration of a coordinate: its vd then is F - D v + B e, which enters the equations of the others.
 * Actuator states z (currents, pressures) are the last inputs of the equations, and their rates are the last efforts.
 *
 * The inputs of a point are p, the starts of q, v and z, and the inputs that other components drive; its states are q,
 * v and z. A position is r(q, p) + w^T q with whole numbers w, so that an angle may go around. Its velocity and
 * acceleration are exact derivatives.
 *
 * The functions M, V, F, D, B and r were learned. Each is a dictionary, a sum of products of sines, cosines and powers,
 * to which a network may add. Another network may add forces that depend on q, p, v and u. A reaction, the force of a
 * joint or spring, is
 *
 *     A(q, p) vd + sum over i >= j of C_ij(q, p) v_i v_j + D(q, p) v + F(q, p) + B(q, p) e
 *
 * with separate functions.
 */
#ifndef MOTION_H
#define MOTION_H

#include "formulas.h"
#include "model.h"
#include "states.h"
#include "tape.h"

/* Quantity of the motion that an output shows. */
typedef enum {
    SHOWN_POSITION,
    SHOWN_VELOCITY,
    SHOWN_ACCELERATION,
    SHOWN_KINETIC_ENERGY,
    SHOWN_POTENTIAL_ENERGY,
    SHOWN_REACTION,
    SHOWN_EFFORT
} ShownKind;

typedef struct {
    ShownKind kind;
    size_t which; /* position, also of its derivatives; reaction; effort */
} Shown;

/* Results of the equations: accelerations, efforts, the lower triangle of M row by row, and V. */
enum {
    FOUND_MASSES = COORDINATE_COUNT + EFFORT_COUNT,
    FOUND_POTENTIAL = FOUND_MASSES + COORDINATE_COUNT * (COORDINATE_COUNT + 1) / 2
};

enum {
    PARAMETER_COUNT = FIRST_DRIVEN - STATE_COUNT,
    DRIVEN_COUNT = INPUT_COUNT - FIRST_DRIVEN,
    CONFIGURATION = COORDINATE_COUNT + PARAMETER_COUNT,
    EQUATION_INPUTS = CONFIGURATION + COORDINATE_COUNT + DRIVEN_COUNT + ACTUATOR_STATES,
    REACTION_INPUTS = CONFIGURATION + COORDINATE_COUNT + FOUND_MASSES
};

extern const Tape model_equations; /* of (q, p, v, u) */
extern const Tape model_positions; /* r(q, p) + w^T q */
extern const Tape model_reactions; /* of (q, p, v), accelerations and efforts */
extern const int model_periodic[COORDINATE_COUNT]; /* nonzero if a turn leaves the equations unchanged */
extern const Real model_windings[POSITION_SIZE * COORDINATE_COUNT]; /* w of each position */
extern const Shown model_shown[OUTPUT_COUNT];

/* Working memory of an evaluation in one kind of numbers, with jets of them along the motion. */
#define MOTION_WORK(Name, Number, Along)         \
    typedef struct {                             \
        Number point[COLUMN_COUNT];              \
        Number results[RESULT_COUNT];            \
        Number equations[EQUATION_REGISTERS];    \
        Number reactions[REACTION_REGISTERS];    \
        Along positions[POSITION_REGISTERS];     \
    } Name

MOTION_WORK(RealWork, Real, Jet);
MOTION_WORK(JetWork, Jet, Nested);

/* Working memory of one evaluation at a time. */
typedef struct {
    RealWork real;
    JetWork jet;
    Solver solver;
} Scratch;

#endif
