/* Preloaded into user-mode Linux up to 6.12 on x86-64.
 *
 * These kernels keep the floating-point state of a guest thread in a buffer of fixed size and hand exactly that much to
 * PTRACE_SETREGSET(NT_X86_XSTATE). The host's kernel insists on its whole XSAVE area, which is larger on processors with
 * AMX, and answers EFAULT: the guest panics at its first process ("ptrace set fp regs failed, errno = 14").
 *
 * Here a short state is padded to the host's size, and the state components that lie beyond the guest's buffer are marked
 * as being in their initial configuration, in both directions. A write of what has just been read from a thread that has
 * not run in between is left out: it saves one system call in two.
 */
#define _GNU_SOURCE
#include <cpuid.h>
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

enum { XSTATE_BV_OFFSET = 512, LEGACY_AND_HEADER = 576, AREA_MAX = 1 << 16, SEEN_MAX = 8192, SLOTS = 256 };

typedef long ptrace_fn(enum __ptrace_request, ...);

struct seen {
    pid_t pid;
    size_t length;
    char state[SEEN_MAX];
};

static struct seen seen_by_slot[SLOTS];
static char area[AREA_MAX] __attribute__((aligned(64)));
static size_t host_length;

/* The XSTATE_BV bits of the components that end within `length` bytes of the standard-format area. */
static uint64_t components_within(size_t length)
{
    static size_t known_for;
    static uint64_t known;
    unsigned eax, ebx, ecx, edx;

    if (known_for == length)
        return known;
    uint64_t mask = 3; /* x87 and SSE live in the first 512 bytes */
    for (unsigned i = 2; i < 63; i++)
        if (__get_cpuid_count(0xd, i, &eax, &ebx, &ecx, &edx) && eax && (size_t)ebx + eax <= length)
            mask |= 1ull << i;
    known_for = length;
    return known = mask;
}

static void drop_components_beyond(char *state, size_t length)
{
    uint64_t present;

    if (length < LEGACY_AND_HEADER)
        return;
    memcpy(&present, state + XSTATE_BV_OFFSET, sizeof present);
    present &= components_within(length);
    memcpy(state + XSTATE_BV_OFFSET, &present, sizeof present);
}

static long read_area(ptrace_fn *host_ptrace, pid_t pid, void *set)
{
    struct iovec whole = {area, sizeof area};
    long result = host_ptrace(PTRACE_GETREGSET, pid, set, &whole);

    if (result >= 0)
        host_length = whole.iov_len;
    return result;
}

static long get_state(ptrace_fn *host_ptrace, pid_t pid, void *set, struct iovec *guest)
{
    struct seen *seen = &seen_by_slot[pid & (SLOTS - 1)];
    long result = read_area(host_ptrace, pid, set);

    if (result < 0)
        return result;
    if (guest->iov_len > host_length)
        guest->iov_len = host_length;
    memcpy(guest->iov_base, area, guest->iov_len);
    if (guest->iov_len < host_length)
        drop_components_beyond(guest->iov_base, guest->iov_len);
    seen->pid = 0;
    if (guest->iov_len <= SEEN_MAX) {
        seen->pid = pid;
        seen->length = guest->iov_len;
        memcpy(seen->state, guest->iov_base, guest->iov_len);
    }
    return result;
}

static long set_state(ptrace_fn *host_ptrace, pid_t pid, void *set, struct iovec *guest)
{
    struct seen *seen = &seen_by_slot[pid & (SLOTS - 1)];
    struct iovec whole = {area, 0};
    size_t length;

    if (!host_length && read_area(host_ptrace, pid, set) < 0)
        return -1;
    length = guest->iov_len < host_length ? guest->iov_len : host_length;
    if (seen->pid == pid && seen->length == length && !memcmp(seen->state, guest->iov_base, length))
        return 0;
    seen->pid = 0;
    memcpy(area, guest->iov_base, length);
    if (length < host_length) {
        memset(area + length, 0, host_length - length);
        drop_components_beyond(area, length);
    }
    whole.iov_len = host_length;
    return host_ptrace(PTRACE_SETREGSET, pid, set, &whole);
}

long ptrace(enum __ptrace_request request, ...)
{
    static ptrace_fn *host_ptrace;
    va_list arguments;
    pid_t pid;
    void *address, *data;

    va_start(arguments, request);
    pid = va_arg(arguments, pid_t);
    address = va_arg(arguments, void *);
    data = va_arg(arguments, void *);
    va_end(arguments);
    if (!host_ptrace)
        host_ptrace = (ptrace_fn *)dlsym(RTLD_NEXT, "ptrace");
    if ((uintptr_t)address == NT_X86_XSTATE && request == PTRACE_GETREGSET)
        return get_state(host_ptrace, pid, address, data);
    if ((uintptr_t)address == NT_X86_XSTATE && request == PTRACE_SETREGSET)
        return set_state(host_ptrace, pid, address, data);
    /* reading and writing the integer registers leaves the floating-point state alone; all else may run the thread */
    if (request != PTRACE_GETREGS && request != PTRACE_SETREGS)
        seen_by_slot[pid & (SLOTS - 1)].pid = 0;
    return host_ptrace(request, pid, address, data);
}
