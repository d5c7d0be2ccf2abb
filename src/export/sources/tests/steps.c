/*
 * Reads steps: whether it begins anew, the point, then size, tolerance, whether inputs are clamped, and the first and
 * second rate of the first driven input. Prints how each ends, how far it came if it failed, and the columns after the
 * inputs, which are states or what is remembered. A step that does not begin anew goes on from those before.
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
