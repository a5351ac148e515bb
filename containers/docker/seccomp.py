"""Filter of system calls in containers, stricter than Docker's default.

It allows what programs need and nothing else. Beyond Docker's default it forbids:

- sockets other than UNIX, IP and routing information. AF_VSOCK reaches the hypervisor from a container without a
  network; AF_ALG, AF_CAN and others reach code of the kernel that few have examined.
- io_uring and asynchronous I/O, which have limits for the whole machine and, in io_uring, a long list of faults.
- programs for 32-bit processors: their calls are others, and `socketcall` cannot be filtered.
- calls without a use in a container, such as `modify_ldt`, `vmsplice` and `name_to_handle_at`.

Every call that could create or enter a namespace, mount, load code into the kernel or read its memory is
forbidden, as in Docker's default for containers without capabilities.
"""

from __future__ import annotations

import errno
import json
import socket
from typing import Any

NEW_NAMESPACES = 0x7E020000  # all flags of `clone` that create namespaces
NETLINK_ROUTE = 0  # lists network interfaces, which DDS needs
PERSONALITIES = (0, 0xFFFFFFFF)  # that of Linux, and the query of the present one
ABSENT = ("clone3", "io_uring_setup", "io_uring_enter", "io_uring_register")  # programs have a fallback for old kernels
ALLOWED = " ".join(
    (
        # processes and threads
        "execve execveat exit exit_group fork vfork wait4 waitid kill tkill tgkill pidfd_open pidfd_send_signal",
        "getpid getppid gettid getpgid getpgrp getsid setpgid setsid set_tid_address set_robust_list get_robust_list",
        "futex futex_waitv futex_wait futex_wake futex_requeue rseq membarrier restart_syscall arch_prctl prctl",
        "ptrace process_vm_readv process_vm_writev seccomp",
        "landlock_create_ruleset landlock_add_rule landlock_restrict_self",
        "riscv_flush_icache",
        # users and limits
        "getuid geteuid getgid getegid getgroups getresuid getresgid setuid setgid setgroups setreuid setregid",
        "setresuid setresgid setfsuid setfsgid capget capset umask",
        "getrlimit setrlimit prlimit64 getrusage times sysinfo uname getcpu",
        "getpriority setpriority ioprio_get ioprio_set sched_yield sched_getaffinity sched_setaffinity sched_getattr",
        "sched_setattr sched_getparam sched_setparam sched_getscheduler sched_setscheduler sched_get_priority_max",
        "sched_get_priority_min sched_rr_get_interval",
        # signals
        "rt_sigaction rt_sigpending rt_sigprocmask rt_sigqueueinfo rt_sigreturn rt_sigsuspend rt_sigtimedwait",
        "rt_tgsigqueueinfo sigaltstack signalfd signalfd4 pause alarm",
        # memory
        "brk mmap mprotect munmap mremap msync madvise mincore mlock mlock2 mlockall munlock munlockall memfd_create",
        "pkey_alloc pkey_free pkey_mprotect mseal map_shadow_stack",
        "shmget shmat shmdt shmctl semget semop semtimedop semctl msgget msgsnd msgrcv msgctl",
        "mq_open mq_unlink mq_timedsend mq_timedreceive mq_notify mq_getsetattr",
        # files
        "open openat openat2 creat close close_range dup dup2 dup3 fcntl flock ioctl lseek read write readv writev",
        "pread64 pwrite64 preadv pwritev preadv2 pwritev2 sendfile copy_file_range splice tee readahead fadvise64",
        "fallocate truncate ftruncate fsync fdatasync sync syncfs sync_file_range",
        "stat fstat lstat newfstatat statx statfs fstatfs access faccessat faccessat2 cachestat",
        "getcwd chdir fchdir",
        "mkdir mkdirat rmdir rename renameat renameat2 link linkat symlink symlinkat unlink unlinkat",
        "readlink readlinkat mknod mknodat getdents getdents64 utime utimes futimesat utimensat",
        "chmod fchmod fchmodat fchmodat2 chown fchown lchown fchownat",
        "getxattr lgetxattr fgetxattr setxattr lsetxattr fsetxattr listxattr llistxattr flistxattr removexattr",
        "lremovexattr fremovexattr",
        "inotify_init inotify_init1 inotify_add_watch inotify_rm_watch",
        # waiting and time
        "select pselect6 poll ppoll epoll_create epoll_create1 epoll_ctl epoll_wait epoll_pwait epoll_pwait2",
        "eventfd eventfd2 pipe pipe2 timerfd_create timerfd_gettime timerfd_settime",
        "nanosleep clock_nanosleep clock_gettime clock_getres gettimeofday time getitimer setitimer",
        "timer_create timer_delete timer_gettime timer_getoverrun timer_settime getrandom",
        # sockets; `socket` and `socketpair` have rules of their own
        "bind connect listen accept accept4 getsockname getpeername getsockopt setsockopt shutdown",
        "sendto sendmsg sendmmsg recvfrom recvmsg recvmmsg",
    )
).split()


def profile() -> str:
    """Return the profile as JSON, in the form of Docker's option `seccomp`."""
    rules = [
        _rule(ALLOWED),
        *(_rule(["socket"], _equal(0, family)) for family in (socket.AF_UNIX, socket.AF_INET, socket.AF_INET6)),
        _rule(["socket"], _equal(0, socket.AF_NETLINK), _equal(2, NETLINK_ROUTE)),
        _rule(["socketpair"], _equal(0, socket.AF_UNIX)),
        _rule(["clone"], {"index": 0, "value": NEW_NAMESPACES, "valueTwo": 0, "op": "SCMP_CMP_MASKED_EQ"}),
        *(_rule(["personality"], _equal(0, each)) for each in PERSONALITIES),
        {"names": list(ABSENT), "action": "SCMP_ACT_ERRNO", "errnoRet": errno.ENOSYS},
    ]
    # Without a list of architectures the filter is for that of the machine alone.
    return json.dumps({"defaultAction": "SCMP_ACT_ERRNO", "defaultErrnoRet": errno.EPERM, "syscalls": rules})


def _rule(names: list[str], *arguments: dict[str, Any]) -> dict[str, Any]:
    """Return a rule that allows calls whose arguments all match."""
    return {"names": names, "action": "SCMP_ACT_ALLOW", "args": list(arguments)}


def _equal(index: int, value: int) -> dict[str, Any]:
    return {"index": index, "value": int(value), "op": "SCMP_CMP_EQ"}
