/*
 * Worst-case cost of a step, in multiplications, additions and divisions:
 *
 *     K (G + 5 (m + y) + 5 + 8 w + 2 c d + 6 f) + 8
 *
 * with m inputs, y outputs, and K = ceil(size of the step / model_sample_time) samples. The training support has w
 * inputs, d coordinates, c components and f measures. G is the cost of the graph (graph.c). model_data.h has the number
 * for a step of model_time_step.
 *
 * Each sample also moves all numbers of the memory by one sample. Outputs between two samples take three operations
 * each when a host reads them. If inputs act directly, each takes 2 m more, and so does each measured output.
 */
#include "evaluator.h"
#include <float.h>
#include <math.h>
#include <string.h>

/* Tolerance, as a part of a sample time, for a communication point to coincide with a sample. */
static const double SAME = 1e-6;

/* Adds a multiple of the direct effect of inputs to outputs. `inputs` begins with the first driven input. */
static void add_direct(Real factor, const double *inputs, double outputs[OUTPUT_COUNT])
{
#if MODEL_HAS_DIRECT
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        Real sum = R(0.0);
        for (size_t j = 0; j < DRIVEN_COUNT; j++) {
            sum += model_direct[DRIVEN_COUNT * i + j] * (Real)inputs[j];
        }
        outputs[i] = (double)((Real)outputs[i] + factor * sum);
    }
#else
    (void)factor;
    (void)inputs;
    (void)outputs;
#endif
}

static void start_sample(double sample[SAMPLE_SIZE], const double outputs[OUTPUT_COUNT], const double *inputs)
{
    memcpy(sample, outputs, OUTPUT_COUNT * sizeof *sample);
    add_direct(R(-1.0), inputs, sample);
    memcpy(sample + OUTPUT_COUNT, model_hidden, (SAMPLE_SIZE - OUTPUT_COUNT) * sizeof *sample);
}

void model_start(double point[COLUMN_COUNT])
{
    const double *outputs = point + PARAMETER_COUNT;
    const double *inputs = outputs + OUTPUT_COUNT;
    const size_t starts = PAST_STARTS;
    const size_t past_inputs = PAST_INPUTS;
#if MODEL_HAS_SUPPORT
    for (size_t i = MEMORY_MEANS; i < MEMORY_DISTANCE; i++) {
        point[i] = 0.0;
    }
    point[MEMORY_DISTANCE] = -1.0;
#endif
    /* a past at rest */
    for (size_t i = MEMORY; i < MEMORY_INPUTS; i += SAMPLE_SIZE) {
        start_sample(point + i, outputs, point + FIRST_DRIVEN);
    }
    for (size_t i = 0; i < past_inputs; i++) {
        /* with a single sample, the start does not matter: the first step takes the inputs at its beginning */
        point[MEMORY_INPUTS + i] = starts == 0 ? 0.0 : inputs[i % starts];
    }
    start_sample(point + MEMORY_NEXT, outputs, point + FIRST_DRIVEN);
    point[MEMORY_PHASE] = 0.0;
}

/* ---- Outputs and their derivatives: functions of the memory, and of inputs that act directly ---- */

/* Returns the weight of the next sample in the outputs. */
static Real share_of_next(const double point[COLUMN_COUNT])
{
    const double phase = point[MEMORY_PHASE];
    /* shortly after a sample, the outputs are still those of the sample */
    if (phase <= SAME) {
        return R(0.0);
    }
    return phase > 1.0 ? R(1.0) : (Real)phase;
}

static void blend(Real share, const double columns[COLUMN_COUNT], double outputs[OUTPUT_COUNT])
{
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        const Real now = (Real)columns[MEMORY + i];
        const Real next = (Real)columns[MEMORY_NEXT + i];
        outputs[i] = (double)(now + share * (next - now));
    }
    add_direct(R(1.0), columns + FIRST_DRIVEN, outputs);
}

void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT])
{
    (void)scratch;
    blend(share_of_next(point), point, results);
}

void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT])
{
    (void)scratch;
    blend(share_of_next(point), direction, derivative);
}

void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first[RESULT_COUNT],
                       double second[RESULT_COUNT])
{
    (void)scratch;
    blend(share_of_next(point), rates, first);
    blend(share_of_next(point), second_rates, second);
}

void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT])
{
    const Real share = share_of_next(point);
    (void)scratch;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        gradient[i] = 0.0;
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        const Real weight = (Real)weights[i];
        gradient[MEMORY + i] = (double)((R(1.0) - share) * weight);
        gradient[MEMORY_NEXT + i] = (double)(share * weight);
#if MODEL_HAS_DIRECT
        for (size_t j = 0; j < DRIVEN_COUNT; j++) {
            double *of_input = gradient + FIRST_DRIVEN + j;
            *of_input = (double)((Real)*of_input + weight * model_direct[DRIVEN_COUNT * i + j]);
        }
#endif
    }
}

/* ---- From sample to sample ---- */

/* Puts the inputs, `since` seconds after the beginning of the step, in front of the past inputs. */
static void take_inputs(double point[COLUMN_COUNT], const Step *step, double since)
{
    double *past = point + MEMORY_INPUTS;
    const size_t driven_count = DRIVEN_COUNT;
    memmove(past + DRIVEN_COUNT, past, (PAST_INPUTS - DRIVEN_COUNT) * sizeof *past);
    for (size_t i = 0; i < driven_count; i++) {
        const Drive drive = drive_of(step, point, FIRST_DRIVEN + i);
        past[i] = (double)driven(&drive, (Real)since);
    }
}

static bool uses_measured(const double point[COLUMN_COUNT])
{
    return point[MEMORY_USE_MEASURED] > 0.5;
}

/*
 * If measured outputs are used, replaces the last sample by those `since` seconds after the beginning of the step.
 * Comes after take_inputs.
 */
static void take_measured(double point[COLUMN_COUNT], const Step *step, Real since)
{
    if (!uses_measured(point)) {
        return;
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        const size_t column = MEMORY_MEASURED + i;
        const Real rate = (Real)step->rates[column] + R(0.5) * since * (Real)step->second_rates[column];
        point[MEMORY + i] = (double)((Real)point[column] + since * rate);
    }
    add_direct(R(-1.0), point + MEMORY_INPUTS, point + MEMORY);
}

static void take(const double *values, size_t count, Real *to)
{
    for (size_t i = 0; i < count; i++) {
        to[i] = (Real)values[i];
    }
}

/* Computes the next sample from the memory. Returns true if it and the outputs before it are finite. */
static bool compute_next(Scratch *scratch, double point[COLUMN_COUNT])
{
    Real *z = scratch->graph;
    bool finite = true;
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        finite = finite && MATH(fabs)((Real)point[MEMORY + i]) < REAL_HUGE;
    }
    take(point + MEMORY, FED_BACK, z);
    take(point + MEMORY_INPUTS, PAST_INPUTS, z + FED_BACK);
    take(point, PARAMETER_COUNT, z + FED_BACK + PAST_INPUTS);
    real_graph(scratch->graph);
    for (size_t i = 0; i < SAMPLE_SIZE; i++) {
        const Real next = scratch->graph[NUMBER_COUNT - SAMPLE_SIZE + i];
        point[MEMORY_NEXT + i] = (double)next;
        finite = finite && MATH(fabs)(next) < REAL_HUGE;
    }
    return finite;
}

#if MODEL_HAS_SUPPORT
/* Returns the distance of a value from the range of its measure, relative to the width of the range. */
static Real beyond(size_t measure, Real value)
{
    const Real min = model_support_ranges[2 * measure];
    const Real max = model_support_ranges[2 * measure + 1];
    Real width = max - min;
    if (!(width > R(0.0))) {
        width = max != R(0.0) ? MATH(fabs)(max) : R(1.0);
    }
    return (min - value > value - max ? min - value : value - max) / width;
}

/* Sets the inputs before the first sample to those of the start or, if these are unknown, to those of the sample. */
static void begin_inputs(double point[COLUMN_COUNT])
{
    const size_t starts = PAST_STARTS;
    const size_t watched = WATCHED_COUNT;
    const bool known = starts > 0 && !uses_measured(point);
    const double *before = known ? point + PARAMETER_COUNT + OUTPUT_COUNT : point + MEMORY_INPUTS;
    for (size_t i = 0; i < watched; i++) {
        point[MEMORY_MEANS + i] = before[i];
        point[MEMORY_LAST + i] = before[i];
        point[MEMORY_CHANGES + i] = 0.0;
    }
    point[MEMORY_DISTANCE] = 0.0;
}

/* Computes the measures of the transition to the next sample. */
static void measure(double point[COLUMN_COUNT], Real measures[MEASURE_COUNT])
{
    Real *coordinates = measures + 3 * WATCHED_COUNT;
    Real *components = coordinates + COORDINATE_COUNT;
    Real *pairs = components + COMPONENT_COUNT;
    const double *input = point + MEMORY_INPUTS;
    const size_t watched = WATCHED_COUNT;
    const size_t component_count = COMPONENT_COUNT;
    const size_t paired = PAIRED_COUNT;
    for (size_t i = 0; i < watched; i++) {
        const Real now = (Real)input[i];
        const Real change = now - (Real)point[MEMORY_LAST + i];
        Real mean = (Real)point[MEMORY_MEANS + i];
        Real changes = (Real)point[MEMORY_CHANGES + i];
        mean += (now - mean) / model_support_samples;
        changes += (MATH(fabs)(change) - changes) / model_support_samples;
        point[MEMORY_MEANS + i] = (double)mean;
        point[MEMORY_LAST + i] = (double)now;
        point[MEMORY_CHANGES + i] = (double)changes;
        measures[i] = now;
        measures[WATCHED_COUNT + i] = change;
        measures[2 * WATCHED_COUNT + i] = changes;
        coordinates[i] = mean;
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        const Real next = (Real)point[MEMORY_NEXT + i];
        coordinates[WATCHED_COUNT + i] = next;
        coordinates[WATCHED_COUNT + OUTPUT_COUNT + i] = next - (Real)point[MEMORY + i];
    }
    for (size_t i = OUTPUT_COUNT; i < SAMPLE_SIZE; i++) {
        coordinates[WATCHED_COUNT + OUTPUT_COUNT + i] = (Real)point[MEMORY_NEXT + i];
    }
    for (size_t i = 0; i < component_count; i++) {
        const Real *weights = model_support_components + COORDINATE_COUNT * i;
        Real sum = R(0.0);
        for (size_t j = 0; j < COORDINATE_COUNT; j++) {
            sum += weights[j] * coordinates[j];
        }
        components[i] = sum;
    }
    for (size_t i = 1; i < paired; i++) {
        for (size_t j = 0; j < i; j++) {
            *pairs++ = components[i] + components[j];
            *pairs++ = components[i] - components[j];
        }
    }
}

static Real larger(Real a, Real b)
{
    return a > b ? a : b;
}

/* Updates the distance of the transition to the next sample from the training, and the residual of errors made outside. */
static void compare(double point[COLUMN_COUNT])
{
    static const Real negligible = R(0.003); /* relative to the width of a range */
    static const Real least = R(1e-6);       /* smaller errors become zero */
    const bool measured = uses_measured(point) && model_support_settling < model_support_fading;
    Real measures[MEASURE_COUNT];
    Real own = R(0.0);
    bool outside = false;
    if (point[MEMORY_DISTANCE] < 0.0) {
        begin_inputs(point);
    }
    measure(point, measures);
    for (size_t i = 0; i < MEASURE_COUNT; i++) {
        outside |= measures[i] < model_support_ranges[2 * i] || measures[i] > model_support_ranges[2 * i + 1];
    }
    /* usually all are inside, and this check takes less time than distances */
    for (size_t i = 0; outside && i < MEASURE_COUNT; i++) {
        own = larger(own, beyond(i, measures[i]));
    }
    if (own < negligible) {
        own = R(0.0);
    }
    const Real kept = measured ? model_support_settling : model_support_fading;
    const Real added = own < R(1.0) ? own : R(1.0);
    const Real error = kept * (Real)point[MEMORY_ERROR] + (R(1.0) - model_support_fading) * added;
    const Real distance = larger(larger(own, model_support_settling * (Real)point[MEMORY_DISTANCE]), error);
    point[MEMORY_ERROR] = error < least ? 0.0 : (double)error;
    point[MEMORY_DISTANCE] = distance < negligible ? 0.0 : (double)distance;
    if (!(distance < REAL_HUGE)) {
        point[MEMORY_DISTANCE] = DBL_MAX;
    }
}
#endif

/* Makes the next sample the last one. */
static void pass_sample(double point[COLUMN_COUNT])
{
    double *past = point + MEMORY;
    memmove(past + SAMPLE_SIZE, past, (PAST_OUTPUTS - SAMPLE_SIZE) * sizeof *past);
    memcpy(past, point + MEMORY_NEXT, SAMPLE_SIZE * sizeof *past);
    point[MEMORY_PHASE] = 0.0;
}

/* Clamps a time since the beginning of a step to the step. */
static double within(double since, double size)
{
    if (since < 0.0) {
        return 0.0;
    }
    return since > size ? size : since;
}

static Advance go_on(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, Failure *failure)
{
    const double begin = point[MEMORY_PHASE];
    const double end = begin + step->size / model_sample_time;
    double passed = 0.0;
    if (end - begin > MAX_STEPS) {
        return ADVANCE_TOO_MANY_STEPS;
    }
    /* each sample that the step does more than touch */
    while (end - passed > SAME) {
        if (point[MEMORY_PHASE] <= SAME) {
            const double since = within((passed - begin) * model_sample_time, step->size);
            take_inputs(point, step, since);
            take_measured(point, step, (Real)since);
            if (!compute_next(scratch, point)) {
                failure->after = since + model_sample_time;
                return ADVANCE_NOT_FINITE;
            }
#if MODEL_HAS_SUPPORT
            compare(point);
#endif
        }
        if (end - passed < 1.0 - SAME) {
            break;
        }
        passed += 1.0;
        pass_sample(point);
    }
    point[MEMORY_PHASE] = end - passed;
    return ADVANCE_DONE;
}

Advance model_advance(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, Failure *failure)
{
    memcpy(scratch->before, point + MEMORY, sizeof scratch->before);
    const Advance result = go_on(scratch, point, step, failure);
    if (result != ADVANCE_DONE) {
        memcpy(point + MEMORY, scratch->before, sizeof scratch->before);
    }
    return result;
}
