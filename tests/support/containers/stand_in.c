/* Stand-in for the Environment endpoint in an image without any other file. The argument is its behaviour. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

static void end(int number) {
    (void)number;
    static const char words[] = "last words\n";
    (void)!write(1, words, sizeof words - 1);
    _exit(3);
}

static void tell(const char *what, long result) { printf("%s: %s\n", what, result < 0 ? strerror(errno) : "allowed"); }

static void quit(int number) { _exit(128 + number); }

int main(int count, char **words) {
    const char *behaviour = count > 1 ? words[1] : "";
    signal(SIGUSR1, end);
    signal(SIGTERM, quit);
    if (!strcmp(behaviour, "eat")) /* memory, until it is killed */
        for (;;) memset(malloc(1 << 20), 1, 1 << 20);
    if (!strcmp(behaviour, "fork")) { /* as many processes as it gets, then it says how many */
        int made = 0;
        for (int child; made < 100000 && (child = fork()) >= 0; made++)
            if (child == 0) for (;;) pause();
        printf("%d processes\n", made);
        fflush(stdout);
        end(0);
    }
    if (!strcmp(behaviour, "fill")) { /* its home, then it says how many MB went in and how long that took */
        static char block[1 << 20];
        long most = count > 2 ? atol(words[2]) : 1 << 20, megabytes = 0;
        int file = open("/home/rce/filled", O_CREAT | O_WRONLY, 0600);
        struct timespec begin, now;
        clock_gettime(CLOCK_MONOTONIC, &begin);
        while (megabytes < most && write(file, block, sizeof block) == sizeof block) megabytes++;
        clock_gettime(CLOCK_MONOTONIC, &now);
        printf("%ld MB in %.2f s\n", megabytes, now.tv_sec - begin.tv_sec + (now.tv_nsec - begin.tv_nsec) / 1e9);
        fflush(stdout);
        end(0);
    }
    if (!strcmp(behaviour, "calls")) { /* system calls, then it says which were allowed */
        tell("unix", socket(AF_UNIX, SOCK_STREAM, 0));
        tell("inet", socket(AF_INET, SOCK_DGRAM, 0));
        tell("inet6", socket(AF_INET6, SOCK_DGRAM, 0));
        tell("routes", socket(AF_NETLINK, SOCK_RAW, 0));
        tell("netfilter", socket(AF_NETLINK, SOCK_RAW, 12));
        tell("vsock", socket(40, SOCK_STREAM, 0));
        tell("algorithms", socket(38, SOCK_SEQPACKET, 0));
        tell("can", socket(29, SOCK_RAW, 1));
        tell("io_uring", syscall(425, 1, 0));
        tell("aio", syscall(SYS_io_setup, 1, 0));
        tell("unshare", unshare(CLONE_NEWUSER));
        tell("clone", syscall(SYS_clone, CLONE_NEWUSER | SIGCHLD, 0, 0, 0, 0));
        tell("fork", fork());
        fflush(stdout);
        end(0);
    }
    if (!strcmp(behaviour, "inotify")) { /* as many inotify instances as it gets, which it holds */
        int made = 0;
        while (made < 2000 && inotify_init() >= 0) made++;
        printf("%d instances\n", made);
    }
    if (!strcmp(behaviour, "record")) { /* a recording that has only its ends, at the socket that it was told */
        static const char magic[] = "\x89MCAP0\r\n";
        struct sockaddr_un place = {.sun_family = AF_UNIX};
        char verdict[1000];
        int store = socket(AF_UNIX, SOCK_STREAM, 0);
        strncpy(place.sun_path, getenv("RCE_RECORDINGS"), sizeof place.sun_path - 1);
        while (connect(store, (struct sockaddr *)&place, sizeof place) < 0) usleep(10000);
        (void)!write(store, "box\n", 4);
        (void)!read(store, verdict, sizeof verdict);
        for (int part = 0; part < 2; part++) (void)!write(store, magic, 8);
        shutdown(store, SHUT_WR);
        (void)!read(store, verdict, sizeof verdict);
    }
    puts("ready");
    fflush(stdout);
    for (;;) pause();
}
