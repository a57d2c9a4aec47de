/* A program that answers well, but for what its first argument says. The second argument is a mark that nothing else has. */
#define _POSIX_C_SOURCE 200809L
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const char *mode;

static int is(const char *name) { return !strcmp(mode, name); }

static void wait_for(double seconds) {
    struct timespec time = {(time_t)seconds, (long)((seconds - (double)(time_t)seconds) * 1e9)};
    while (nanosleep(&time, &time)) {}
}

static void hang(void) { wait_for(600); }

static void say(const char *line) {
    printf("%s\n", line);
    fflush(stdout);
}

static void out(int file, const char *bytes, size_t length) {
    while (length > 0) {
        ssize_t written = write(file, bytes, length);
        if (written <= 0) _exit(6);
        bytes += written;
        length -= (size_t)written;
    }
}

static void endless(const char *part) {
    char block[1 << 16];
    size_t length = strlen(part), size = 0;
    while (size + length <= sizeof block) memcpy(block + size, part, length), size += length;
    for (;;) out(1, block, size);
}

static void fail(const char *message) {
    fprintf(stderr, "%s\n", message);
    exit(1);
}

static void stubborn(void) {
    signal(SIGTERM, SIG_IGN);
    signal(SIGHUP, SIG_IGN);
}

static void hello(int protocol, const char *name, const char *size, int actions, const char *more) {
    printf("{\"protocol\": %d, \"name\": \"%s\", \"observation_size\": %s, \"actions\": %d, \"max_steps\": 10%s}\n", protocol,
           name, size, actions, more);
    fflush(stdout);
}

static void flood(void) {
    for (int i = 0; i < 100000; i++) out(2, "\x1b[31mno line break ", 19);
    _exit(5);
}

static void grandchild(void) {
    if (fork() == 0) hang();
    _exit(4);
}

static void huge(void) {
    char *name = malloc(1 << 21);
    if (!name) _exit(6);
    memset(name, 'n', (1 << 21) - 1);
    name[(1 << 21) - 1] = 0;
    hello(1, name, "2", 2, "");
}

static void at_hello(void) {
    if (is("silent")) hang();
    else if (is("drip")) for (;;) out(1, "1", 1), wait_for(0.02);
    else if (is("endless line")) endless("x");
    else if (is("endless lines")) endless("step 1\n");
    else if (is("binary")) out(1, "\xff\xfe\x00\x80\n", 5);
    else if (is("banner")) printf("Welcome to my task!\n"), hello(1, "Task", "2", 2, "");
    else if (is("no json")) say("hello yourself");
    else if (is("list")) say("[1, 2]");
    else if (is("protocol")) hello(2, "Task", "2", 2, "");
    else if (is("huge size")) hello(1, "Task", "1000000000", 2, "");
    else if (is("no actions")) hello(1, "Task", "2", 0, "");
    else if (is("missing")) say("{\"protocol\": 1, \"name\": \"Task\"}");
    else if (is("huge")) huge();
    else if (is("names")) hello(1, "Task", "2", 2, ", \"action_names\": [\"one\"]");
    else if (is("steering")) hello(1, "\\u001b[2J", "2", 2, "");
    else if (is("mirror"))
        hello(1, "Task", "2", 2, ", \"mirror\": {\"observation\": [[7, 1], [0, 1]], \"actions\": [0, 1]}");
    else if (is("error")) say("error no display \x1b[31m");
    else if (is("killed")) raise(SIGKILL);
    else if (is("import")) fail("ModuleNotFoundError: No module named 'task'");
    else if (is("grandchild")) grandchild();
    else if (is("flood")) flood();
    else hello(1, "Task", "2", 2, "");
}

#ifdef __linux__
#include <fcntl.h>
#include <sys/ioctl.h>

/* Reads the question, and nothing after it: it answers when there is something to read. Its pipe has two pages, so it is full early. */
static void deaf(void) {
    char question[64];
    int seen = 0, waiting = 0, set_pipe_size = 1031;
    fcntl(0, set_pipe_size, 8192);
    if (read(0, question, sizeof question) <= 0) return;
    say("{\"protocol\": 1, \"name\": \"Deaf\", \"observation_size\": 1, \"actions\": 2, \"max_steps\": 1000000}");
    for (;; wait_for(0.0001)) {
        if (ioctl(0, FIONREAD, &waiting) || waiting <= seen) continue;
        say(waiting < 35 ? "reset 0" : "step 0 0 0 0"); /* Two resets have 34 bytes. */
        seen = waiting;
    }
}
#endif

static void random_reset(void) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    printf("reset %ld 1\n", now.tv_nsec);
    fflush(stdout);
}

static void at_reset(void) {
    if (is("dies at reset")) _exit(3);
    else if (is("silent at reset")) hang();
    else if (is("count")) say("reset 1 2 3");
    else if (is("random")) random_reset();
    else if (is("empty")) say("");
    else if (is("words")) say("reset one two");
    else if (is("stderr")) fail("the disk is on fire");
    else say("reset 0.5 0.25");
}

static void late(void) {
    say("step 1 0 0 1 2");
    wait_for(0.1);
    say("step 9 0 0 9 9");
    if (fork() == 0) _exit(0);
}

static void closes(void) {
    char line[256];
    say("step 1 0 0 1 2");
    if (fgets(line, sizeof line, stdin)) close(1);
    hang();
}

static void at_step(void) {
    if (is("dies at step")) _exit(3);
    else if (is("segfault")) raise(SIGSEGV);
    else if (is("ignores SIGTERM")) stubborn(), hang();
    else if (is("nan")) say("step 1 0 0 nan 1");
    else if (is("infinite")) say("step inf 0 0 1 1");
    else if (is("large")) say("step 1 0 0 1e300 1");
    else if (is("flag")) say("step 1 2 0 1 1");
    else if (is("short")) say("step 1 0 0 1");
    else if (is("bare")) say("step");
    else if (is("prints")) say("I go left\nstep 1 0 0 1 2");
    else if (is("other")) say("reset 1 2");
    else if (is("late")) late();
    else if (is("error at step")) say("error no such action");
    else if (is("closes")) closes();
    else if (is("exception")) fail("ZeroDivisionError: division by zero");
    else say("step 1 0 0 1 2");
}

static void at_render(void) {
    if (is("frame")) say("frame 10 10 AAAA");
    else if (is("base64")) say("frame 1 1 ????");
    else if (is("size")) say("frame 99999 99999 AAAA");
    else if (is("endless frame")) endless("A");
    else say("no frame");
}

int main(int count, char **arguments) {
    char line[256];
    mode = count > 1 ? arguments[1] : "";
    if (is("never ends")) stubborn();
#ifdef __linux__
    if (is("deaf")) deaf();
#endif
    while (fgets(line, sizeof line, stdin)) {
        if (!strncmp(line, "hello", 5)) at_hello();
        else if (!strncmp(line, "reset", 5)) at_reset();
        else if (!strncmp(line, "step", 4)) at_step();
        else at_render();
    }
    if (is("never ends")) hang();
    return 0;
}
