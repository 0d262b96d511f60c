/* One call of the file system waits: LD_PRELOAD library for tests/integration/test_slow_calls.py.
 *
 * The file in $SLOW_CALLS is mapped: what waits is chosen, and calls are counted, from outside. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

enum { OPEN, MKDIR, STATVFS, RENAME, UNLINK, FSYNC, STAT, WRITE, KINDS };
struct shared {
    atomic_int pid;            /* process whose calls are counted */
    atomic_int kind, number;   /* the call that waits; number 0: none */
    atomic_int waits;          /* 1 while it waits */
    atomic_int count[KINDS];
};
static struct shared *shared;

static void __attribute__((constructor)) map(void) {
    const char *path = getenv("SLOW_CALLS");
    int (*real)(const char *, int, ...) = dlsym(RTLD_NEXT, "open");
    int fd = path ? real(path, O_RDWR) : -1;
    if (fd < 0) return;
    void *at = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (at != MAP_FAILED) shared = at;
    close(fd);
}

static void enter(int kind) {
    if (!shared || shared->pid != getpid()) return;
    int count = ++shared->count[kind];
    if (shared->kind != kind || shared->number != count) return;
    shared->waits = 1;
    for (int i = 0; i < 500 && shared->number; i++) usleep(10000);
    shared->waits = 0;
}

#define REAL(result, name, ...)                                                    \
    static result (*real)(__VA_ARGS__);                                            \
    if (!real) real = dlsym(RTLD_NEXT, #name)
#define OPENING(name)                                                              \
    int name(const char *path, int flags, ...) {                                   \
        va_list rest; va_start(rest, flags); int mode = va_arg(rest, int); va_end(rest); \
        REAL(int, name, const char *, int, ...); enter(OPEN); return real(path, flags, mode); }
OPENING(open) OPENING(open64)
#define OPENING_AT(name)                                                           \
    int name(int at, const char *path, int flags, ...) {                           \
        va_list rest; va_start(rest, flags); int mode = va_arg(rest, int); va_end(rest); \
        REAL(int, name, int, const char *, int, ...); enter(OPEN); return real(at, path, flags, mode); }
OPENING_AT(openat) OPENING_AT(openat64)
#define CALL(kind, name, taken, given)                                             \
    int name taken { static int (*real) taken; if (!real) real = dlsym(RTLD_NEXT, #name); \
        enter(kind); return real given; }
CALL(MKDIR, mkdir, (const char *path, mode_t mode), (path, mode))
CALL(STATVFS, statvfs, (const char *path, struct statvfs *to), (path, to))
CALL(STATVFS, statvfs64, (const char *path, struct statvfs64 *to), (path, to))
CALL(RENAME, rename, (const char *from, const char *to), (from, to))
CALL(UNLINK, unlink, (const char *path), (path))
CALL(UNLINK, unlinkat, (int at, const char *path, int flags), (at, path, flags))
CALL(FSYNC, fsync, (int fd), (fd))
CALL(FSYNC, fdatasync, (int fd), (fd))
CALL(STAT, stat, (const char *path, struct stat *to), (path, to))
CALL(STAT, stat64, (const char *path, struct stat64 *to), (path, to))
CALL(STAT, lstat, (const char *path, struct stat *to), (path, to))
CALL(STAT, lstat64, (const char *path, struct stat64 *to), (path, to))
CALL(STAT, fstatat, (int at, const char *path, struct stat *to, int flags), (at, path, to, flags))
CALL(STAT, fstatat64, (int at, const char *path, struct stat64 *to, int flags), (at, path, to, flags))

ssize_t write(int fd, const void *data, size_t size) {
    REAL(ssize_t, write, int, const void *, size_t);
    struct stat64 found;
    if (shared && shared->pid == getpid() && !fstat64(fd, &found) && S_ISREG(found.st_mode)) enter(WRITE);
    return real(fd, data, size);
}
