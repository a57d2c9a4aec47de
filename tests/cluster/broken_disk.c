// A file system such as network disks can be, for LD_PRELOAD: every lock fails, and renames, links and syncs are slow.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <sys/file.h>
#include <unistd.h>

static void wait_a_little(void) { usleep(20000); }

int flock(int descriptor, int operation) {
    (void)descriptor, (void)operation;
    errno = ENOLCK;
    return -1;
}

int rename(const char *from, const char *to) {
    wait_a_little();
    return ((int (*)(const char *, const char *))dlsym(RTLD_NEXT, "rename"))(from, to);
}

int renameat2(int from_directory, const char *from, int to_directory, const char *to, unsigned int flags) {
    wait_a_little();
    return ((int (*)(int, const char *, int, const char *, unsigned int))dlsym(RTLD_NEXT, "renameat2"))(
        from_directory, from, to_directory, to, flags);
}

// As on a file system without hard links.
int link(const char *from, const char *to) {
    (void)from, (void)to;
    errno = EPERM;
    return -1;
}

int linkat(int from_directory, const char *from, int to_directory, const char *to, int flags) {
    (void)from_directory, (void)from, (void)to_directory, (void)to, (void)flags;
    errno = EPERM;
    return -1;
}

int fdatasync(int descriptor) {
    wait_a_little();
    return ((int (*)(int))dlsym(RTLD_NEXT, "fdatasync"))(descriptor);
}
