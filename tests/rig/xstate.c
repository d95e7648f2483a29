/* Makes Linux 6.1 as User Mode Linux run on processors with AMX.
 *
 * The kernel keeps 2696 bytes of registers for each process (all up to
 * AVX-512) and sets them with PTRACE_SETREGSET. With AMX the register file has
 * about 11 kB, and the host answers EFAULT to anything shorter. Preloaded into
 * the kernel process, this ptrace() fills up with registers in their initial
 * state: a process in the guest can not use AMX, the guest grants no
 * permission for it.
 */
#define _GNU_SOURCE
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

/* The kernel process has one thread that traces. Zero beyond what is copied
 * in, hence never marked as in use. */
static char registers[1 << 16] __attribute__((aligned(64)));
static size_t wanted_bytes;

long ptrace(enum __ptrace_request request, ...)
{
	va_list list;
	long word, rc;

	va_start(list, request);
	pid_t pid = va_arg(list, pid_t);
	void *address = va_arg(list, void *);
	void *data = va_arg(list, void *);
	va_end(list);

	/* these return the word, where the system call stores it */
	if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA ||
	    request == PTRACE_PEEKUSER) {
		rc = syscall(SYS_ptrace, request, pid, address, &word);
		if (rc < 0)
			return rc;
		errno = 0;
		return word;
	}
	if (request != PTRACE_SETREGSET || (long)address != NT_X86_XSTATE)
		return syscall(SYS_ptrace, request, pid, address, data);

	struct iovec *given = data;
	struct iovec whole = {registers, sizeof(registers)};
	if (!wanted_bytes) {
		rc = syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &whole);
		if (rc < 0)
			return rc;
		wanted_bytes = whole.iov_len;
		memset(registers, 0, sizeof(registers));
	}
	if (given->iov_len >= wanted_bytes)
		return syscall(SYS_ptrace, request, pid, address, data);
	memcpy(registers, given->iov_base, given->iov_len);
	whole.iov_len = wanted_bytes;
	return syscall(SYS_ptrace, request, pid, address, &whole);
}
