/*
 * A model without states: one map, from columns that the inputs become to the outputs, or a network for each of some
 * instants, between which the outputs are linear in the time. A map is a network (network.c) or a graph (graph.c). No
 * function takes a time that depends on the numbers.
 */
#ifndef MAPS_H
#define MAPS_H

#include "model.h"

#include MAP_HEADER

/*
 * How an input becomes columns: as it is; one of a column's values as a column for each, 1 for the nearest and 0 for the
 * others; or, if the period is not zero, as sine and cosine of 2 pi (x - start) / period.
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

/* Outputs of a map at columns. */
void map_evaluate(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS], Real outputs[OUTPUT_COUNT]);

/*
 * First derivatives of the outputs, and second ones unless the pointers are null, along a curve on which the columns
 * have the given ones.
 */
void map_along_curve(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                     const Real rates[MAP_COLUMNS], const Real *second_rates, Real first[OUTPUT_COUNT],
                     Real *second);

/* J^T weights */
void map_adjoint(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                 const Real weights[OUTPUT_COUNT], Real gradient[MAP_COLUMNS]);

#endif
