/*
 * Model without states: a map from columns, computed from the inputs, to the outputs. With time points, there is a
 * network for each, and outputs are linear in time between them. A map is a network (network.c) or a graph (graph.c).
 * The duration of a function does not depend on the numbers.
 */
#ifndef MAPS_H
#define MAPS_H

#include "model.h"

#include MAP_HEADER

/*
 * How an input becomes columns: an input with valid values becomes a column for each, 1 for the nearest and 0 for the
 * others. If the period is not zero, it becomes the sine and cosine of 2 pi (x - start) / period. Otherwise it is a
 * column itself.
 */
typedef struct {
    double start;
    double period;
} Turn;

extern const Turn model_turns[COLUMN_COUNT];

#if MODEL_HAS_INSTANTS
extern const Real model_instants[INSTANT_COUNT]; /* s, ascending */
#endif

/* Working memory of one evaluation at a time. */
typedef struct {
    MapScratch map;
} Scratch;

/* Computes the outputs of a map at columns. */
void map_evaluate(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS], Real outputs[OUTPUT_COUNT]);

/*
 * Computes the first derivatives of the outputs along a curve, given those of the columns. Computes second derivatives
 * unless the pointers are null.
 */
void map_along_curve(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                     const Real rates[MAP_COLUMNS], const Real *second_rates, Real first[OUTPUT_COUNT],
                     Real *second);

/* Computes J^T weights. */
void map_adjoint(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                 const Real weights[OUTPUT_COUNT], Real gradient[MAP_COLUMNS]);

#endif
