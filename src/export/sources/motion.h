/*
 * Equations of motion in generalized coordinates q with velocities v, parameters p and inputs u:
 *
 *     qd = v
 *     M(q, p) vd + h = -dV/dq + F(q, p) - D(q, p) v + B(q, p) e
 *     h_i = sum over j, k of (dM_ij/dq_k - dM_jk/dq_i / 2) v_j v_k
 *
 * The efforts e are formulas of parameters, inputs, and of positions r(q, p) + w^T q and their rates: model_efforts.h. A
 * driver may prescribe the acceleration of a coordinate: F - D v + B e then is its vd, and the equations of the others
 * hold with it.
 *
 * The inputs of a point are p, the starts of q and v, u; its states are q and v. A position is r(q, p) + w^T q with
 * whole numbers w, so that an angle may go around; its velocity and acceleration are exact derivatives. The functions
 * M, V, F, D, B and r were learned: each is a sum of products of sines, cosines and powers, a dictionary, to which a
 * network may add. Another network may add forces that depend on q, p, v and u. A reaction, the force of a joint or
 * spring, is
 *
 *     A(q, p) vd + sum over i >= j of C_ij(q, p) v_i v_j + D(q, p) v + F(q, p) + B(q, p) e
 *
 * with functions of its own.
 */
#ifndef MOTION_H
#define MOTION_H

#include "formulas.h"
#include "functions.h"
#include "jets.h"
#include "model.h"
#include "states.h"

/* What an output shows of the motion. */
typedef enum {
    SHOWN_POSITION,
    SHOWN_VELOCITY,
    SHOWN_ACCELERATION,
    SHOWN_KINETIC_ENERGY,
    SHOWN_POTENTIAL_ENERGY,
    SHOWN_REACTION
} ShownKind;

typedef struct {
    ShownKind kind;
    size_t position; /* which one, or whose derivative; which reaction */
} Shown;

/* Where the law has what: the lower triangle of M row by row, V, positions of the efforts, F, D and B row by row. */
enum {
    LAW_POTENTIAL = COORDINATE_COUNT * (COORDINATE_COUNT + 1) / 2,
    LAW_POSITIONS = LAW_POTENTIAL + 1,
    LAW_FORCE = LAW_POSITIONS + EFFORT_POSITIONS,
    LAW_DAMPING = LAW_FORCE + COORDINATE_COUNT,
    LAW_EFFORTS = LAW_DAMPING + COORDINATE_COUNT * COORDINATE_COUNT,
    LAW_COUNT = LAW_EFFORTS + COORDINATE_COUNT * EFFORT_COUNT
};

/* Where a reaction has what: A, the lower triangle of C row by row, D, F, B. */
enum {
    REACTION_SQUARES = COORDINATE_COUNT,
    REACTION_VELOCITIES = REACTION_SQUARES + COORDINATE_COUNT * (COORDINATE_COUNT + 1) / 2,
    REACTION_REST = REACTION_VELOCITIES + COORDINATE_COUNT,
    REACTION_EFFORTS = REACTION_REST + 1,
    REACTION_COUNT = REACTION_EFFORTS + EFFORT_COUNT
};

extern const Dictionary model_law;
extern const Dictionary model_positions;
extern const Dictionary model_reactions;
extern const NetworkTerm model_law_network;
extern const NetworkTerm model_positions_network;
extern const NetworkTerm model_forces_network; /* of (q, p, v, u) */
extern const int model_periodic[COORDINATE_COUNT]; /* whether efforts are the same a turn of each coordinate later */
extern const Real model_effort_windings[EFFORT_POSITION_SIZE * COORDINATE_COUNT]; /* w of each position of the efforts */
extern const int model_prescribed[COORDINATE_COUNT]; /* whether the acceleration of each coordinate is */
extern const Real model_windings[POSITION_SIZE * COORDINATE_COUNT]; /* w of each position */
extern const Shown model_shown[OUTPUT_COUNT];

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
        Number network[(3 + 2 * COORDINATE_COUNT) * NETWORK_WIDTH];   \
        Number law[LAW_COUNT];                                        \
        Number gradient[LAW_COUNT * COORDINATE_COUNT];                \
        Number factors[COORDINATE_COUNT * COORDINATE_COUNT];          \
        Number effort_positions[EFFORT_POSITION_SIZE];                \
        Number effort_rates[EFFORT_POSITION_SIZE];                    \
        Number efforts[EFFORT_SIZE];                                  \
        Number arguments[ARGUMENT_SIZE];                              \
        Number accelerations[COORDINATE_COUNT];                       \
        Number reactions[REACTION_SIZE];                              \
        Along along[DICTIONARY_COLUMNS];                              \
        Along along_atoms[ATOM_COUNT];                                \
        Along along_slopes[ATOM_COUNT];                               \
        Along along_network[2 * NETWORK_WIDTH];                       \
        Along positions[POSITION_SIZE];                               \
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
