/*
 * Reads steps: a flag for a new start, the point, size, tolerance, a flag for clamped inputs, and the first and second
 * rates of the first driven input. Prints the result of each step, the progress of a failed one, and the columns after
 * the inputs, which are states or memory. Without a new start, a step continues from the last one.
 */
#include "evaluator.h"
#include <stdio.h>

int main(void)
{
    static Scratch scratch;
    double rest[COLUMN_COUNT] = {0.0};
    double anew;
    while (scanf("%lf", &anew) == 1) {
        double point[COLUMN_COUNT];
        double rates[COLUMN_COUNT] = {0.0};
        double second_rates[COLUMN_COUNT] = {0.0};
        double size;
        double tolerance;
        double clamp;
        Failure failure = {0.0, 0, 0.0};
        for (size_t i = 0; i < COLUMN_COUNT; i++) {
            if (scanf("%lf", &point[i]) != 1) {
                return 1;
            }
            if (i >= INPUT_COUNT && !(anew > 0.0)) {
                point[i] = rest[i];
            }
        }
        if (scanf("%lf %lf %lf %lf %lf", &size, &tolerance, &clamp, &rates[FIRST_DRIVEN],
                  &second_rates[FIRST_DRIVEN]) != 5) {
            return 1;
        }
        const Step step = {size, tolerance, NULL, rates, second_rates, clamp > 0.0};
        const Advance result = model_advance(&scratch, point, &step, &failure);
        const bool came = result != ADVANCE_DONE && result != ADVANCE_TOO_MANY_STEPS;
        printf("%d %.17g", (int)result, came ? failure.after : 0.0);
        for (size_t i = INPUT_COUNT; i < COLUMN_COUNT; i++) {
            rest[i] = point[i];
            printf(" %.17g", rest[i]);
        }
        printf("\n");
    }
    return 0;
}
