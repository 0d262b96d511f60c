/* The system calls of the daemon's loop in exchange mode, and nothing else, in C.
 *
 *     c_loop PERIOD_NS TICKS SPIN_NS
 *
 * A tick sleeps and spins, sends a request to a socket, waits for the answer, reads it, and writes a
 * sample to a pipe. Two children answer the requests and empty the pipe. The program prints the
 * processor time per tick over windows of 0.1 s, in ns, as a list in JSON.
 */
#define _GNU_SOURCE
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { PRIORITY = 80, ECHO_PRIORITY = 20, REQUEST = 16, ANSWER = 36, SAMPLE = 92, WARM_UP = 2 };
static const long long SECOND = 1000000000, MARGIN = 90000, WINDOW = 100000000;

static long long now_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static struct timespec at(long long ns) { return (struct timespec){ns / SECOND, ns % SECOND}; }

static void child(int fd, int answers) {
    struct sched_param priority = {ECHO_PRIORITY};
    char bytes[4096];
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    sched_setscheduler(0, SCHED_FIFO, &priority);
    while (read(fd, bytes, sizeof bytes) > 0)
        if (answers && write(fd, bytes, ANSWER) != ANSWER) break;
    _exit(0);
}

static void wait_until(int epoll, int timer, long long due, int only_timer) {
    static long long set;
    struct itimerspec until = {{0, 0}, at(due)};
    struct epoll_event events[8];
    if (due != set) timerfd_settime(timer, TFD_TIMER_ABSTIME, &until, NULL);
    set = due;
    do {
        epoll_wait(epoll, events, 8, -1);
    } while (only_timer && now_ns(CLOCK_MONOTONIC) < due);
}

int main(int argc, char **argv) {
    if (argc != 4) return 2;
    long long period = atoll(argv[1]), ticks = atoll(argv[2]), spin = atoll(argv[3]);
    int line[2], out[2], epoll = epoll_create1(0), timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK);
    struct sched_param priority = {PRIORITY};
    char bytes[4096] = {0};
    if (socketpair(AF_UNIX, SOCK_STREAM, 0, line) || pipe(out)) return 1;
    if (!fork()) child(line[1], 1);
    if (!fork()) child(out[0], 0);
    prctl(PR_SET_TIMERSLACK, 1);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    sched_setscheduler(0, SCHED_FIFO, &priority);
    epoll_ctl(epoll, EPOLL_CTL_ADD, line[0], &(struct epoll_event){.events = EPOLLIN, .data.fd = line[0]});
    epoll_ctl(epoll, EPOLL_CTL_ADD, timer, &(struct epoll_event){.events = EPOLLIN, .data.fd = timer});
    long long due = now_ns(CLOCK_MONOTONIC) + period, began = due, used = 0, done = 0;
    for (long long n = -WARM_UP; n <= ticks; n++) {
        wait_until(epoll, timer, due - spin - MARGIN, 1);
        struct timespec wake = at(due - spin);
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &wake, NULL);
        long long now;
        while ((now = now_ns(CLOCK_MONOTONIC)) < due) {}
        due += period * (1 + (now > due ? (now - due) / period : 0));
        if (write(line[0], bytes, REQUEST) != REQUEST) return 1;
        wait_until(epoll, timer, due - spin - MARGIN, 0);
        if (read(line[0], bytes, sizeof bytes) <= 0 || write(out[1], bytes, SAMPLE) != SAMPLE) return 1;
        if (n == 0 || (n > 0 && (now - began >= WINDOW || n == ticks))) {
            long long cpu = now_ns(CLOCK_THREAD_CPUTIME_ID);
            if (n > 0) printf("%s%.1f", done ? ", " : "[", (double)(cpu - used) / (n - done));
            began = now, used = cpu, done = n;
        }
    }
    puts("]");
    return 0;
}
