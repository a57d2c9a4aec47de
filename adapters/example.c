// A task of its own in C, as an environment of cartpole-dqn: push a point on a line until it rests at 0.
// Compile: cc -O2 -ffp-contract=off -o dock adapters/example.c -lm
// Train:   cartpole-dqn train --config adapters/example.json
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *HELLO = "{\"protocol\": 1, \"name\": \"Dock\", \"observation_size\": 2, \"actions\": 3, \"max_steps\": 100, "
                           "\"solved_return\": -5, \"return_range\": [-200, 0], \"steps_per_second\": 10, "
                           "\"action_names\": [\"left\", \"nothing\", \"right\"], \"observation_names\": [\"x\", \"v\"], "
                           "\"mirror\": {\"observation\": [[0, -1], [1, -1]], \"actions\": [2, 1, 0]}}";

// A number in [-1, 1) that looks random and follows from the seed: SplitMix64.
static double start(uint64_t seed) {
    uint64_t z = seed + 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-52 - 1.0;
}

int main(void) {
    char line[64];
    double x = 0.0, v = 0.0;
    while (fgets(line, sizeof line, stdin)) {
        if (strcmp(line, "hello 1\n") == 0) {
            puts(HELLO);
        } else if (strncmp(line, "reset ", 6) == 0) {
            x = start(strtoull(line + 6, NULL, 10)), v = 0.0;
            printf("reset %.17g %.17g\n", x, v);
        } else if (strncmp(line, "step ", 5) == 0) {
            v += 0.1 * (atoi(line + 5) - 1), x += 0.1 * v;
            int lost = fabs(x) > 2.0; // The time limit of 100 steps is kept by cartpole-dqn.
            printf("step %.17g %d 0 %.17g %.17g\n", lost ? -20.0 : -fabs(x), lost, x, v);
        } else {
            puts(strcmp(line, "render\n") == 0 ? "no frame" : "error this request is unknown");
        }
        fflush(stdout);
    }
    return 0;
}
