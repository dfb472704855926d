/* Faults of a disk and a clock, put between a process and the C library by LD_PRELOAD.
 *
 * Files whose path begins with SPOOL_FAULTS_PREFIX meet them. What happens is said by the 56 bytes of the
 * file SPOOL_FAULTS_CONTROL, which is mapped, so that it changes while the process runs. With
 * SPOOL_FAULTS_LOG every change of these files is written there, in order, to be replayed up to any moment.
 * Calls that open, write, sync, rename or remove such a file are counted; between "first" and "last", where
 * these are given, exactly the calls of these numbers fail, opening for reading as well.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { NONE, FULL, BROKEN, READ_ONLY };
enum { MOST = 4096 };

struct control {
    int32_t mode;
    int32_t sync_delay_ms;
    int32_t write_delay_ms;
    int32_t unused;
    int64_t clock_offset_ns;
    int64_t first;
    int64_t last;
    int64_t calls;
};

static struct control none;
static volatile struct control *control = &none;
static const char *prefix;
static int log_descriptor = -1;
static char *names[MOST];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void begin(void) {
    prefix = getenv("SPOOL_FAULTS_PREFIX");
    const char *place = getenv("SPOOL_FAULTS_CONTROL");
    if (place) {
        int descriptor = (int)syscall(SYS_openat, AT_FDCWD, place, O_RDWR | O_CLOEXEC, 0);
        if (descriptor >= 0) {
            void *mapped = mmap(NULL, sizeof(struct control), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
            if (mapped != MAP_FAILED) control = mapped;
            syscall(SYS_close, descriptor);
        }
    }
    const char *log = getenv("SPOOL_FAULTS_LOG");
    if (log)
        log_descriptor =
            (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static int ours(const char *path) {
    return prefix && path && strncmp(path, prefix, strlen(prefix)) == 0;
}

static const char *name_of(int descriptor) {
    return descriptor >= 0 && descriptor < MOST ? names[descriptor] : NULL;
}

static void note(char what, const char *path, const char *other, int64_t number, const void *data, size_t size) {
    if (log_descriptor < 0) return;
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now);
    int64_t at = now.tv_sec * 1000000000LL + now.tv_nsec;
    uint32_t lengths[3] = {(uint32_t)strlen(path), other ? (uint32_t)strlen(other) : 0, (uint32_t)size};
    pthread_mutex_lock(&lock);
    syscall(SYS_write, log_descriptor, &what, 1);
    syscall(SYS_write, log_descriptor, &at, 8);
    syscall(SYS_write, log_descriptor, &number, 8);
    syscall(SYS_write, log_descriptor, lengths, sizeof lengths);
    syscall(SYS_write, log_descriptor, path, lengths[0]);
    if (other) syscall(SYS_write, log_descriptor, other, lengths[1]);
    if (size) syscall(SYS_write, log_descriptor, data, size);
    pthread_mutex_unlock(&lock);
}

static void wait_ms(int milliseconds) {
    struct timespec time = {milliseconds / 1000, (milliseconds % 1000) * 1000000L};
    if (milliseconds > 0) syscall(SYS_nanosleep, &time, NULL);
}

/* The error that a change of a file meets, 0 for none. */
static int fault(int takes_room) {
    int64_t number = __atomic_add_fetch(&control->calls, 1, __ATOMIC_RELAXED);
    if (control->first && (number < control->first || number > control->last)) return 0;
    switch (control->mode) {
    case FULL: return takes_room ? ENOSPC : 0;
    case BROKEN: return EIO;
    case READ_ONLY: return EROFS;
    default: return 0;
    }
}

static int refuse(int error) {
    errno = error;
    return -1;
}

static int opened(int descriptor, const char *path, int flags, int fresh) {
    if (descriptor >= 0 && descriptor < MOST) {
        free(names[descriptor]);
        names[descriptor] = ours(path) ? strdup(path) : NULL;
        if (names[descriptor] && (flags & O_CREAT) && fresh) note('C', path, NULL, 0, NULL, 0);
        if (names[descriptor] && (flags & O_TRUNC) && !fresh) note('T', path, NULL, 0, NULL, 0);
    }
    return descriptor;
}

static int open_any(const char *path, int flags, mode_t mode) {
    int fresh = 0;
    int changes = flags & (O_WRONLY | O_RDWR | O_CREAT);
    if (ours(path) && (changes || control->first)) {
        struct stat about;
        fresh = changes && stat(path, &about) != 0;
        int error = fault(fresh);
        if (error) return refuse(error);
    }
    return opened((int)syscall(SYS_openat, AT_FDCWD, path, flags, mode), path, flags, fresh);
}

#define MODE(flags) \
    mode_t mode = 0; \
    if ((flags) & (O_CREAT | O_TMPFILE)) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); }

int open(const char *path, int flags, ...) { MODE(flags) return open_any(path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE(flags) return open_any(path, flags | O_LARGEFILE, mode); }
int openat(int folder, const char *path, int flags, ...) {
    MODE(flags)
    if (path[0] == '/') return open_any(path, flags, mode);
    return (int)syscall(SYS_openat, folder, path, flags, mode);
}
int openat64(int folder, const char *path, int flags, ...) {
    MODE(flags)
    if (path[0] == '/') return open_any(path, flags | O_LARGEFILE, mode);
    return (int)syscall(SYS_openat, folder, path, flags | O_LARGEFILE, mode);
}

int close(int descriptor) {
    if (descriptor >= 0 && descriptor < MOST && names[descriptor]) {
        free(names[descriptor]);
        names[descriptor] = NULL;
    }
    return (int)syscall(SYS_close, descriptor);
}

ssize_t write(int descriptor, const void *data, size_t size) {
    const char *name = name_of(descriptor);
    if (name) {
        int error = fault(1);
        if (error == ENOSPC && size > 4096) size /= 2; /* some of it still fits */
        else if (error) return refuse(error);
        wait_ms(control->write_delay_ms);
    }
    ssize_t written = syscall(SYS_write, descriptor, data, size);
    if (name && written > 0) note('W', name, NULL, 0, data, (size_t)written);
    return written;
}

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t at) {
    if (name_of(descriptor)) {
        int error = fault(1);
        if (error) return refuse(error);
        wait_ms(control->write_delay_ms);
    }
    return syscall(SYS_pwrite64, descriptor, data, size, at);
}
ssize_t pwrite(int descriptor, const void *data, size_t size, off_t at) {
    return pwrite64(descriptor, data, size, at);
}

int fsync(int descriptor) {
    const char *name = name_of(descriptor);
    if (name) {
        wait_ms(control->sync_delay_ms);
        int error = fault(0);
        if (error) return refuse(error);
        note('S', name, NULL, 0, NULL, 0);
        return 0; /* the machine keeps its power: no need to wait for its disk */
    }
    return (int)syscall(SYS_fsync, descriptor);
}

int fdatasync(int descriptor) { return fsync(descriptor); }

static int truncate_any(int descriptor, off_t size) {
    const char *name = name_of(descriptor);
    if (name) {
        int error = fault(0);
        if (error) return refuse(error);
        note('T', name, NULL, size, NULL, 0);
    }
    return (int)syscall(SYS_ftruncate, descriptor, size);
}
int ftruncate(int descriptor, off_t size) { return truncate_any(descriptor, size); }
int ftruncate64(int descriptor, off64_t size) { return truncate_any(descriptor, size); }

int rename(const char *from, const char *to) {
    if (ours(to)) {
        int error = fault(0);
        if (error) return refuse(error);
        note('R', from, to, 0, NULL, 0);
    }
    return (int)syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
}

int unlink(const char *path) {
    if (ours(path)) {
        int error = fault(0);
        if (error) return refuse(error);
        note('U', path, NULL, 0, NULL, 0);
    }
    return (int)syscall(SYS_unlinkat, AT_FDCWD, path, 0);
}

int mkdir(const char *path, mode_t mode) {
    if (ours(path)) {
        int error = fault(1);
        if (error) return refuse(error);
    }
    return (int)syscall(SYS_mkdirat, AT_FDCWD, path, mode);
}

int statvfs64(const char *path, struct statvfs64 *about) {
    int done = REAL(statvfs64)(path, about);
    if (!done && ours(path) && control->mode == FULL) about->f_bavail = about->f_bfree = 0;
    return done;
}
int statvfs(const char *path, struct statvfs *about) {
    int done = REAL(statvfs)(path, about);
    if (!done && ours(path) && control->mode == FULL) about->f_bavail = about->f_bfree = 0;
    return done;
}

/* A stepped clock is seen by Python and by ROS's clock: deadlines of waits by it belong to the kernel. */
int clock_gettime(clockid_t which, struct timespec *time) {
    int done = (int)syscall(SYS_clock_gettime, which, time);
    int64_t offset = control->clock_offset_ns;
    if (done || which != CLOCK_REALTIME || !offset) return done;
    Dl_info caller;
    if (!dladdr(__builtin_return_address(0), &caller) || !caller.dli_fname) return done;
    if (!strstr(caller.dli_fname, "python") && !strstr(caller.dli_fname, "rcutils")) return done;
    int64_t now = time->tv_sec * 1000000000LL + time->tv_nsec + offset;
    time->tv_sec = now / 1000000000LL;
    time->tv_nsec = now % 1000000000LL;
    return done;
}
