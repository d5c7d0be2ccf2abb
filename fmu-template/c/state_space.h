/*
 * State space: derivatives of states x, and outputs y, are any functions of parameters p, inputs u and states:
 *
 *     xd = f(p, u, x)
 *     y = g(p, u, x)
 *
 * The inputs of a point are p, the starts of x, and u; its states are x. A graph (graph.c) of the columns (p, u, x)
 * computes the results y, xd.
 */
#ifndef STATE_SPACE_H
#define STATE_SPACE_H

#include "graph.h"
#include "states.h"

/* Number of columns of the graph. */
enum { GRAPH_COLUMNS = COLUMN_COUNT - STATE_COUNT };

extern const bool model_angles[STATE_COUNT];       /* true if whole turns change nothing but the state */
extern const size_t model_given_states[RESULT_COUNT]; /* state that a result shows, or STATE_COUNT */

/* Working memory of an evaluation in one kind of numbers. */
#define STATE_SPACE_WORK(Name, Number)  \
    typedef struct {                    \
        Number point[COLUMN_COUNT];     \
        Number results[RESULT_COUNT];   \
        Number graph[NUMBER_COUNT];     \
    } Name

STATE_SPACE_WORK(RealWork, Real);
STATE_SPACE_WORK(JetWork, Jet);

/* Working memory of one evaluation at a time. */
typedef struct {
    RealWork real;
    JetWork jet;
    Solver solver;
} Scratch;

#endif
