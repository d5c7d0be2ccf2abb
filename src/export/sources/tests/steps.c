/*
 * Reads steps of a motion: whether it begins anew, the point, then size, tolerance, whether inputs are clamped, and the
 * first and second rate of the first driven input. Prints how each ends, how far it came if it failed, and the states.
 * A step that does not begin anew goes on from the states before.
 */
#include "evaluator.h"
#include <stdio.h>

int main(void)
{
    static Scratch scratch;
    double states[STATE_COUNT] = {0.0};
    double anew;
    while (scanf("%lf", &anew) == 1) {
        double point[COLUMN_COUNT];
        double rates[COLUMN_COUNT] = {0.0};
        double second_rates[COLUMN_COUNT] = {0.0};
        double size;
        double tolerance;
        double clamp;
        double after = 0.0;
        for (size_t i = 0; i < COLUMN_COUNT; i++) {
            if (scanf("%lf", &point[i]) != 1) {
                return 1;
            }
            if (i >= INPUT_COUNT && !(anew > 0.0)) {
                point[i] = states[i - INPUT_COUNT];
            }
        }
        if (scanf("%lf %lf %lf %lf %lf", &size, &tolerance, &clamp, &rates[FIRST_DRIVEN],
                  &second_rates[FIRST_DRIVEN]) != 5) {
            return 1;
        }
        const Step step = {size, tolerance, rates, second_rates, clamp > 0.0};
        const Advance result = motion_advance(&scratch, point, &step, &after);
        printf("%d %.17g", (int)result, result == ADVANCE_NOT_FINITE ? after : 0.0);
        for (size_t i = 0; i < STATE_COUNT; i++) {
            states[i] = point[INPUT_COUNT + i];
            printf(" %.17g", states[i]);
        }
        printf("\n");
    }
    return 0;
}
