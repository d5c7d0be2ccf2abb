/*
 * States x whose derivatives are any functions of parameters p, inputs u and states:
 *
 *     xd = f(p, u, x)
 *     y = g(p, u, x)
 *
 * The inputs of a point are p, the starts of x, u; its states are x. A graph (graph.c) of the columns (p, u, x) gives the
 * results y, xd.
 */
#ifndef STATE_SPACE_H
#define STATE_SPACE_H

#include "graph.h"
#include "states.h"

/* Numbers of the graph's columns. */
enum { GRAPH_COLUMNS = COLUMN_COUNT - STATE_COUNT };

extern const bool model_angles[STATE_COUNT];       /* whether whole turns of a state change nothing but it */
extern const size_t model_given_states[RESULT_COUNT]; /* the state that a result is, or STATE_COUNT */

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
