/* A task of two numbers: `walk [MAX_STEPS]`. In the current directory the file `broken` holds the number of the step that fails
   in the first process, which is that of the training, and `moved` what every observation is moved by. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The number in a file, or another one where there is no such file. */
static double number_in(const char *name, double otherwise) {
    FILE *file = fopen(name, "r");
    if (!file) return otherwise;
    double value = otherwise;
    if (fscanf(file, "%lf", &value) != 1) value = otherwise;
    fclose(file);
    return value;
}

int main(int count, char **arguments) {
    const char *max_steps = count > 1 ? arguments[1] : "30";
    FILE *first = fopen("first", "r");
    int is_first = !first;
    if (first) fclose(first);
    if ((first = fopen("first", "a"))) fclose(first);
    double x = 0;
    int steps = 0, time = 0;
    char line[256];
    while (fgets(line, sizeof line, stdin)) {
        const char *argument = strchr(line, ' ');
        if (!argument) return 2;
        if (!strncmp(line, "hello", 5)) {
            printf("{\"protocol\": 1, \"name\": \"Walk\", \"observation_size\": 2, \"actions\": 2, \"max_steps\": %s}\n",
                   max_steps);
        } else {
            if (!strncmp(line, "reset", 5)) {
                x = (double)(strtoull(argument, NULL, 10) % 1000) / 500 - 1;
                time = 0;
                printf("reset");
            } else {
                steps++;
                time++;
                if (is_first && steps == number_in("broken", -1)) {
                    fprintf(stderr, "the walker stumbles\n");
                    return 9;
                }
                x += atoi(argument) == 1 ? 0.25 : -0.25;
                printf("step %.17g %d 0", -fabs(x), fabs(x) > 2);
            }
            printf(" %.17g %.17g\n", x + number_in("moved", 0), time / 30.0);
        }
        fflush(stdout);
    }
    return 0;
}
