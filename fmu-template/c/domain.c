#include "parts.h"
#include <math.h>
#include <stdio.h>

/* How far a value may be outside its range, relative to the range: hosts add up step sizes and convert units. */
static const double TOLERANCE = 1e-9;

/* Returns the distance of a value from the column's range, zero inside, relative to the width of the range. */
static double column_distance(const Column *column, double value)
{
    const double below = (least_valid(column, value) - value) / column->width;
    const double above = (value - largest_valid(column, value)) / column->width;
    const double outside = below > above ? below : above;
    return outside > 0.0 ? outside : 0.0;
}

static bool contains(const Column *column, double value)
{
    const double margin = TOLERANCE * column->width;
    return least_valid(column, value) - margin <= value && value <= largest_valid(column, value) + margin;
}

/* Returns the largest distance from the range of a column; on a tie, that of the last one. */
static Outside outside_ranges(const Instance *instance)
{
    Outside farthest = {0.0, 0, 0.0};
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        const Column *column = &model_columns[i];
        const double value = instance->now.columns[i];
        const double found = column_distance(column, value);
        if (found >= farthest.distance) {
            const double above = value > largest_valid(column, value) ? 1.0 / column->width : 0.0;
            farthest.distance = found;
            farthest.column = i;
            farthest.slope = value < least_valid(column, value) ? -1.0 / column->width : above;
        }
    }
    return farthest;
}

#if MODEL_HAS_COVER
/* Returns the distance from the cube around a center, negative inside, or any distance that is at least `enough`. */
static Outside outside_cube(const Instance *instance, size_t centre, double enough)
{
    const float *at = &model_centres[centre * COVER_COLUMN_COUNT];
    Outside farthest = {-model_cover_radius, model_cover_columns[0], 0.0};
    for (size_t i = 0; i < COVER_COLUMN_COUNT && farthest.distance < enough; i++) {
        const size_t index = model_cover_columns[i];
        const Column *column = &model_columns[index];
        const double off = (instance->now.columns[index] - column->min) / column->width - (double)at[i];
        const double distance = fabs(off) - model_cover_radius;
        if (distance > farthest.distance) {
            farthest.distance = distance;
            farthest.column = index;
            farthest.slope = (off > 0.0 ? 1.0 : -1.0) / column->width;
        }
    }
    return farthest;
}

/*
 * Returns the distance from the cube that contains the point, up to a tolerance, or from the nearest cube, and sets
 * `centre` to that cube. The search begins at the given cube, as a simulation stays near one center for a while.
 */
static Outside outside_cover(const Instance *instance, double tolerance, size_t *centre)
{
    Outside nearest = outside_cube(instance, *centre, HUGE_VAL);
    for (size_t i = 0; i < COVER_COUNT && nearest.distance > tolerance; i++) {
        const Outside found = outside_cube(instance, i, nearest.distance);
        if (found.distance < nearest.distance) {
            nearest = found;
            *centre = i;
        }
    }
    return nearest;
}
#endif

Outside domain_outside(const Instance *instance, size_t centre)
{
    Outside farthest = outside_ranges(instance);
#if MODEL_HAS_COVER
    const Outside of_data = outside_cover(instance, 0.0, &centre);
    if (of_data.distance > farthest.distance) {
        farthest = of_data;
    }
#else
    (void)centre;
#endif
#if MODEL_HAS_SUPPORT
    /* it depends on past samples */
    if (instance->now.columns[MEMORY_DISTANCE] > farthest.distance) {
        farthest.distance = instance->now.columns[MEMORY_DISTANCE];
        farthest.slope = 0.0;
    }
#endif
    if (!(farthest.distance < DBL_MAX)) {
        farthest.distance = DBL_MAX;
    }
    return farthest;
}

static bool is_in_ranges(const Instance *instance)
{
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        if (!contains(&model_columns[i], instance->now.columns[i])) {
            return false;
        }
    }
    return true;
}

/* Returns true if training data are near the point, or if the model does not know its training data. */
static bool is_near_data(const Instance *instance, size_t *centre)
{
#if MODEL_HAS_SUPPORT
    if (instance->now.columns[MEMORY_DISTANCE] > TOLERANCE) {
        return false;
    }
#endif
#if MODEL_HAS_COVER
    return outside_cover(instance, TOLERANCE, centre).distance <= TOLERANCE;
#else
    (void)instance;
    (void)centre;
    return true;
#endif
}

static bool time_is_column(void)
{
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_TIME) {
            return true;
        }
    }
    return false;
}

/*
 * Returns true if a value at this time differs from the value at the start of the run. If time is an input of the
 * network, its outputs are those of a run in which nothing changes.
 */
static bool is_changed(const Instance *instance, size_t index, double value, double time)
{
    return model_columns[index].role != ROLE_TIME && time > instance->now.start_time &&
           !(value == instance->now.at_start[index]) && time_is_column();
}

bool domain_contains(const Instance *instance)
{
    const Snapshot *now = &instance->now;
    size_t centre = instance->centre;
    bool is_inside = !now->changed && is_in_ranges(instance) && is_near_data(instance, &centre);
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        is_inside = is_inside && !is_changed(instance, i, now->columns[i], now->time);
    }
    return is_inside;
}

void domain_describe(const Column *column, char text[VALID_SIZE])
{
    if (column->value_count == 0) {
        snprintf(text, VALID_SIZE, "the training range from %.10g to %.10g", column->min, column->max);
        return;
    }
    size_t length = (size_t)snprintf(text, VALID_SIZE, "the trained values");
    for (size_t i = 0; i < column->value_count && length < VALID_SIZE; i++) {
        const char *comma = i == 0 ? "" : ",";
        length += (size_t)snprintf(text + length, VALID_SIZE - length, "%s %.10g", comma, column->values[i]);
    }
}

bool domain_forbids(Instance *instance, size_t index, double value, double time, Policy policy, Status status)
{
    if (policy != POLICY_ERROR || index >= NAMED_COUNT) { /* memory has no range */
        return false;
    }
    const Column *column = &model_columns[index];
    if (!contains(column, value)) {
        char valid[VALID_SIZE];
        domain_describe(column, valid);
        instance_end(instance, status, "variable `%.100s`: %.10g is outside %s, and domain_policy is 2", column->name,
                     value, valid);
        return true;
    }
    if (is_changed(instance, index, value, time)) {
        instance_end(instance, status,
                     "variable `%.100s`: %.10g instead of %.10g as at the start of the run, and domain_policy is 2",
                     column->name, value, instance->now.at_start[index]);
        return true;
    }
    return false;
}

bool domain_forbids_point(Instance *instance, Policy policy)
{
    for (size_t i = 0; i < NAMED_COUNT; i++) {
        const bool known = model_columns[i].role != ROLE_TIME || instance->now.experiment;
        if (known && domain_forbids(instance, i, instance->now.columns[i], instance->now.time, policy, STATUS_ERROR)) {
            return true;
        }
    }
    if (policy == POLICY_ERROR && instance->now.changed) {
        instance_end(instance, STATUS_ERROR,
                     "inputs or parameters have been changed during the run, which domain_policy 2 forbids");
        return true;
    }
    return false;
}

/* Warns under any policy, since this cannot be clamped. */
static void note_change(Instance *instance, size_t index)
{
    instance->now.changed = true;
    if (instance->warned_of_change) {
        return;
    }
    instance->warned_of_change = true;
    instance_tell(instance, STATUS_WARNING,
                  "variable `%.100s`: changed from %.10g to %.10g during the run; outputs are those of a run "
                  "that has had %.10g since its start (said once a run)",
                  model_columns[index].name, instance->now.at_start[index], instance->now.columns[index],
                  instance->now.columns[index]);
}

void domain_note_value(Instance *instance, size_t index)
{
    if (index >= NAMED_COUNT) { /* memory has no range */
        return;
    }
    const Column *column = &model_columns[index];
    const double value = instance->now.columns[index];
    if (is_changed(instance, index, value, instance->now.time)) {
        note_change(instance, index);
    }
    if (instance->now.policy != POLICY_WARN || instance->warned[index] || contains(column, value)) {
        return;
    }
    instance->warned[index] = true;
    char valid[VALID_SIZE];
    domain_describe(column, valid);
    instance_tell(instance, STATUS_WARNING, "variable `%.100s`: %.10g is outside %s; outputs are %s (said once a run)",
                  column->name, value, valid, column->value_count > 0 ? "those of the nearest" : "extrapolated");
}

Status domain_note_data(Instance *instance, Status refused)
{
    /* while measured outputs replace the history, outputs are not yet predictions */
    const bool is_silent = instance->now.policy == POLICY_CLAMP || instance->warned_of_data || is_measured(instance);
    const bool knows_data = MODEL_HAS_COVER || MODEL_HAS_SUPPORT;
    if (is_silent || !knows_data || !is_in_ranges(instance) || is_near_data(instance, &instance->centre)) {
        return STATUS_OK;
    }
    const double distance = domain_outside(instance, instance->centre).distance;
    if (instance->now.policy == POLICY_ERROR) {
        return instance_end(instance, refused,
                            "the inputs are in their ranges, but %.3f of the ranges away from where training data are "
                            "near, and domain_policy is 2",
                            distance);
    }
    instance->warned_of_data = true;
    instance_tell(instance, STATUS_WARNING,
                  "the inputs are in their ranges, but %.3f of the ranges away from where training data are near; "
                  "outputs are extrapolated (said once a run)",
                  distance);
    return STATUS_OK;
}
