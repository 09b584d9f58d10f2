/* Preloaded into the service by tests/suite/io_faults.rs: writes to the history file are recorded, delayed or refused.
 *
 * IO_LOG=FILE        every write, truncation and sync of history.sqlite and its log, in order
 * IO_DELAY_MS=N      a sync takes so long
 * IO_FAIL_AT=N       the N-th of these calls fails with IO_ERROR (5 = EIO, 28 = ENOSPC, 4 = EINTR), once
 * IO_KILL=CALL:NAME:WHEN:N   the process is killed before or after the N-th CALL (write, sync, cut, rename, open, or any
 *                    of them) on a file whose path holds NAME; a NAME that ends with $ is the end of the path
 *
 * A record: u32 operation (1 write, 2 sync, 3 truncate), u32 file (0 database, 1 log), i64 place, u64 length, data.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int log_fd = -2;
static long calls, fail_at, error_number, delay_ms;

static void begin(void) {
    const char *path = getenv("IO_LOG"), *at = getenv("IO_FAIL_AT");
    const char *number = getenv("IO_ERROR"), *delay = getenv("IO_DELAY_MS");
    log_fd = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600) : -1;
    fail_at = at ? atol(at) : 0;
    error_number = number ? atol(number) : EIO;
    delay_ms = delay ? atol(delay) : 0;
}

static struct { int known; char call[16], name[256], when[16]; long at, seen; } kill_at;

static int holds(const char *path, const char *name) {
    size_t length = strlen(name);
    if (!length || name[length - 1] != '$') return strstr(path, name) != 0;
    size_t path_length = strlen(path);
    return path_length >= --length && !strncmp(path + path_length - length, name, length);
}

/* The process ends here where this is the point. `when` is "before" or "after". */
static void point(const char *call, const char *path, const char *when) {
    if (!kill_at.known) {
        const char *text = getenv("IO_KILL");
        if (!text || sscanf(text, "%15[^:]:%255[^:]:%15[^:]:%ld", kill_at.call, kill_at.name, kill_at.when, &kill_at.at) < 4)
            kill_at.at = 0;
        kill_at.known = 1;
    }
    if (!kill_at.at || strcmp(when, kill_at.when)) return;
    if (strcmp(kill_at.call, "any") && strcmp(kill_at.call, call)) return;
    if (!holds(path, kill_at.name) || __atomic_add_fetch(&kill_at.seen, 1, __ATOMIC_SEQ_CST) != kill_at.at) return;
    kill(getpid(), SIGKILL);
}

static int path_of(int fd, char *path, size_t most) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, most - 1);
    path[length < 0 ? 0 : length] = 0;
    return length >= 0;
}

static void point_of(const char *call, int fd, const char *when) {
    char path[4096];
    if ((!kill_at.known || kill_at.at) && path_of(fd, path, sizeof path)) point(call, path, when);
}

/* 0 the database, 1 its log, -1 another file. */
static int which(int fd) {
    char path[4096];
    if (!path_of(fd, path, sizeof path)) return -1;
    const char *name = strrchr(path, '/');
    if (!name) return -1;
    if (!strcmp(name, "/history.sqlite")) return 0;
    return strcmp(name, "/history.sqlite-wal") ? -1 : 1;
}

/* Counts the call; true when it is the one that fails. */
static int fails(void) {
    if (log_fd == -2) begin();
    calls++;
    return fail_at && calls == fail_at;
}

static void note(uint32_t operation, int file, int64_t place, const void *data, uint64_t length) {
    if (log_fd < 0) return;
    struct { uint32_t operation, file; int64_t place; uint64_t length; } head =
        {operation, (uint32_t)file, place, length};
    syscall(SYS_write, log_fd, &head, sizeof head);
    if (data) syscall(SYS_write, log_fd, data, length);
}

static ssize_t put_there(int fd, const void *data, size_t length, int64_t place, int positioned) {
    int file = which(fd);
    if (file < 0)
        return positioned ? syscall(SYS_pwrite64, fd, data, length, place) : syscall(SYS_write, fd, data, length);
    pthread_mutex_lock(&lock);
    ssize_t done;
    if (fails()) {
        /* Half of it reaches the file, as on a disk that fills up. */
        if (error_number == ENOSPC && positioned) syscall(SYS_pwrite64, fd, data, length / 2, place);
        errno = (int)error_number;
        done = -1;
    } else {
        if (!positioned) place = lseek(fd, 0, SEEK_CUR);
        done = positioned ? syscall(SYS_pwrite64, fd, data, length, place) : syscall(SYS_write, fd, data, length);
        if (done > 0) note(1, file, place, data, (uint64_t)done);
    }
    pthread_mutex_unlock(&lock);
    return done;
}

static ssize_t put(int fd, const void *data, size_t length, int64_t place, int positioned) {
    point_of("write", fd, "before");
    ssize_t done = put_there(fd, data, length, place, positioned);
    int error = errno;
    point_of("write", fd, "after");
    errno = error;
    return done;
}

ssize_t write(int fd, const void *data, size_t length) { return put(fd, data, length, 0, 0); }
ssize_t pwrite(int fd, const void *data, size_t length, off_t place) { return put(fd, data, length, place, 1); }
ssize_t pwrite64(int fd, const void *data, size_t length, off64_t place) { return put(fd, data, length, place, 1); }

static int flush_there(int fd, long number) {
    int file = which(fd);
    if (file < 0) return (int)syscall(number, fd);
    pthread_mutex_lock(&lock);
    int bad = fails();
    if (!bad) note(2, file, 0, 0, 0);
    pthread_mutex_unlock(&lock);
    if (bad) {
        errno = (int)error_number;
        return -1;
    }
    if (delay_ms) {
        struct timespec time = {delay_ms / 1000, delay_ms % 1000 * 1000000};
        nanosleep(&time, 0);
    }
    return (int)syscall(number, fd);
}

static int flush(int fd, long number) {
    point_of("sync", fd, "before");
    int done = flush_there(fd, number), error = errno;
    point_of("sync", fd, "after");
    errno = error;
    return done;
}

int fsync(int fd) { return flush(fd, SYS_fsync); }
int fdatasync(int fd) { return flush(fd, SYS_fdatasync); }

static int cut_there(int fd, int64_t length) {
    int file = which(fd);
    if (file < 0) return (int)syscall(SYS_ftruncate, fd, length);
    pthread_mutex_lock(&lock);
    int done = -1;
    if (fails()) {
        errno = (int)error_number;
    } else {
        done = (int)syscall(SYS_ftruncate, fd, length);
        if (!done) note(3, file, length, 0, 0);
    }
    pthread_mutex_unlock(&lock);
    return done;
}

static int cut(int fd, int64_t length) {
    point_of("cut", fd, "before");
    int done = cut_there(fd, length), error = errno;
    point_of("cut", fd, "after");
    errno = error;
    return done;
}

int ftruncate(int fd, off_t length) { return cut(fd, length); }
int ftruncate64(int fd, off64_t length) { return cut(fd, length); }

int rename(const char *from, const char *to) {
    point("rename", to, "before");
    int done = (int)syscall(SYS_rename, from, to), error = errno;
    point("rename", to, "after");
    errno = error;
    return done;
}

static int open_there(const char *path, int flags, mode_t mode) {
    point("open", path, "before");
    int fd = (int)syscall(SYS_openat, AT_FDCWD, path, flags, mode), error = errno;
    point("open", path, "after");
    errno = error;
    return fd;
}

#define MODE(flags, mode) \
    mode_t mode; \
    va_list rest; \
    va_start(rest, flags); \
    mode = va_arg(rest, mode_t); \
    va_end(rest)

int open(const char *path, int flags, ...) {
    MODE(flags, mode);
    return open_there(path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    MODE(flags, mode);
    return open_there(path, flags | O_LARGEFILE, mode);
}

int shm_open(const char *name, int flags, mode_t mode) {
    static int (*real)(const char *, int, mode_t);
    if (!real) real = (int (*)(const char *, int, mode_t))dlsym(RTLD_NEXT, "shm_open");
    point("open", name, "before");
    int fd = real(name, flags, mode), error = errno;
    point("open", name, "after");
    errno = error;
    return fd;
}
