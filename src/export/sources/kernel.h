/*
 * A template: sums of kernels in one kind of numbers. Before it is included, NUMBER is their type and OF(name) the name
 * of a function of them; without them it has the declarations. With a machine for each output,
 *
 *     y = bias + the sum over its centres c of weight_c exp(-1/2 the sum over the columns of ((z_i - c_i) / length_i)^2)
 *
 * A centre takes, in multiplications, additions and divisions,
 *
 *     4    for a column,
 *     3    besides, and an exponential.
 */

#ifndef NUMBER

typedef struct {
    Real bias;
    const Real *per_length; /* one over the length of each column */
    size_t count;
    const Real *centres; /* one after the other */
    const Real *weights;
} Machine;

extern const Machine model_machines[OUTPUT_COUNT];

#else /* the template */

static void OF(function)(const NUMBER z[MAP_COLUMNS], NUMBER y[OUTPUT_COUNT], NUMBER table[TABLE_SIZE])
{
    (void)table;
    for (size_t output = 0; output < OUTPUT_COUNT; output++) {
        const Machine *machine = &model_machines[output];
        const Real *centre = machine->centres;
        NUMBER sum = OF(constant)(machine->bias);
        for (size_t c = 0; c < machine->count; c++) {
            NUMBER square = OF(constant)(R(0.0));
            for (size_t i = 0; i < MAP_COLUMNS; i++) {
                const NUMBER away = OF(difference)(z[i], OF(constant)(centre[i]));
                const NUMBER distance = OF(scaled)(away, machine->per_length[i]);
                square = OF(sum)(square, OF(product)(distance, distance));
            }
            sum = OF(sum)(sum, OF(scaled)(OF(exponential)(OF(scaled)(square, -R(0.5))), machine->weights[c]));
            centre += MAP_COLUMNS;
        }
        y[output] = sum;
    }
}

#endif
