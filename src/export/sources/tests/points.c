/* Reads points, prints outputs, derivatives along a direction, second derivatives along a curve and a gradient. */
#include "network.h"
#include <stdio.h>

static void print(const double *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        printf("%.17g ", values[i]);
    }
}

int main(void)
{
    static Scratch scratch;
    double point[COLUMN_COUNT];
    double direction[COLUMN_COUNT];
    double second_rates[COLUMN_COUNT];
    double weights[OUTPUT_COUNT];
    size_t read = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        direction[i] = 1.0 + 0.5 * (double)i;
        second_rates[i] = 0.25 - (double)i;
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        weights[i] = 1.0 - 2.0 * (double)i;
    }
    while (scanf("%lf", &point[read]) == 1) {
        double outputs[OUTPUT_COUNT];
        double first[OUTPUT_COUNT];
        double second[OUTPUT_COUNT];
        double gradient[COLUMN_COUNT];
        if (++read < COLUMN_COUNT) {
            continue;
        }
        read = 0;
        network_evaluate(&scratch, point, outputs);
        print(outputs, OUTPUT_COUNT);
        network_directional(&scratch, point, direction, first);
        print(first, OUTPUT_COUNT);
        network_along_curve(&scratch, point, direction, second_rates, first, second);
        print(first, OUTPUT_COUNT);
        print(second, OUTPUT_COUNT);
        network_adjoint(&scratch, point, weights, gradient);
        print(gradient, COLUMN_COUNT);
        printf("\n");
    }
    return 0;
}
