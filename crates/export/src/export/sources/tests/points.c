/* Reads points, prints results, derivatives along a direction, second derivatives along a curve and a gradient. */
#include "evaluator.h"
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
    double weights[RESULT_COUNT];
    size_t read = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        direction[i] = 1.0 + 0.5 * (double)i;
        second_rates[i] = 0.25 - (double)i;
    }
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        weights[i] = 1.0 - 2.0 * (double)i;
    }
    while (scanf("%lf", &point[read]) == 1) {
        double results[RESULT_COUNT];
        double first[RESULT_COUNT];
        double second[RESULT_COUNT];
        double gradient[COLUMN_COUNT];
        if (++read < COLUMN_COUNT) {
            continue;
        }
        read = 0;
        model_evaluate(&scratch, point, results);
        print(results, RESULT_COUNT);
        model_directional(&scratch, point, direction, first);
        print(first, RESULT_COUNT);
        model_along_curve(&scratch, point, direction, second_rates, first, second);
        print(first, RESULT_COUNT);
        print(second, RESULT_COUNT);
        model_adjoint(&scratch, point, weights, gradient);
        print(gradient, COLUMN_COUNT);
        printf("\n");
    }
    return 0;
}
