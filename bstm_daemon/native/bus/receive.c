/* Frames off a SocketCAN socket, up to 64 with one system call: the compiled
 * form of bus/live/receiver.py, with the same rules for what is a frame. The
 * layouts are those of linux/can.h, and only Linux has recvmmsg.
 */
#define _GNU_SOURCE
#include "bus.h"

#include <errno.h>
#include <string.h>

#ifdef __linux__
#include <sys/socket.h>
#include <time.h>

enum { BATCH = 64 };
enum { CLASSIC_SIZE = 16, FD_SIZE = 72, HEAD_SIZE = 8, CLASSIC_BYTES = 8 };
enum { READ_SIZE = FD_SIZE + 1 }; /* a longer frame shows as too long */
#define EXTENDED_FLAG UINT32_C(0x80000000)
#define REMOTE_FLAG UINT32_C(0x40000000)
#define ERROR_FLAG UINT32_C(0x20000000)
#define EXTENDED_MASK UINT32_C(0x1FFFFFFF)
#define STANDARD_MASK UINT32_C(0x7FF)
/* asm-generic/socket.h; libc's names depend on the width of its time_t */
enum { STAMP_OPTION = 35, DROPS_OPTION = 40 };

typedef struct {
    long seconds, nanoseconds;
} Stamp;

typedef union {
    struct cmsghdr aligned;
    char room[CMSG_SPACE(sizeof(Stamp)) + CMSG_SPACE(sizeof(uint32_t))];
} Ancillary;

typedef struct {
    int fd;
    int32_t bus;
    const uint32_t *only; /* rising; NULL for all */
    Py_ssize_t only_count;
    Record *next;
    Py_ssize_t frames, limit; /* limit: of messages, frames or not */
    Py_ssize_t malformed, errors;
    int64_t drops; /* the kernel's count, -1 where it reported none */
    int fault;
} Drain;

static int is_wanted(const Drain *d, uint32_t word)
{
    if (d->only == NULL) return 1;
    Py_ssize_t low = 0, high = d->only_count;
    while (low < high) {
        const Py_ssize_t middle = low + (high - low) / 2;
        if (d->only[middle] < word) low = middle + 1;
        else high = middle;
    }
    return low < d->only_count && d->only[low] == word;
}

/* The stamp [ns], 0 where there is none; notes the count of drops. */
static int64_t stamp_ns_of(struct msghdr *message, Drain *d)
{
    int64_t stamp_ns = 0;
    for (struct cmsghdr *c = CMSG_FIRSTHDR(message); c != NULL;
         c = CMSG_NXTHDR(message, c)) {
        if (c->cmsg_level != SOL_SOCKET) continue;
        if (c->cmsg_type == STAMP_OPTION
            && c->cmsg_len == CMSG_LEN(sizeof(Stamp))) {
            Stamp stamp;
            memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
            stamp_ns = (int64_t)stamp.seconds * 1000000000
                + stamp.nanoseconds;
        } else if (c->cmsg_type == DROPS_OPTION
                   && c->cmsg_len == CMSG_LEN(sizeof(uint32_t))) {
            uint32_t drops;
            memcpy(&drops, CMSG_DATA(c), sizeof drops);
            d->drops = drops;
        }
    }
    return stamp_ns;
}

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void add_frame(Drain *d, struct msghdr *header,
                      const uint8_t *message, unsigned size)
{
    const int64_t kernel_ns = stamp_ns_of(header, d);
    const int64_t stamp_ns = kernel_ns ? kernel_ns : now_ns();
    uint32_t word = 0;
    unsigned length = 0;
    int fits = 0;
    if (size == CLASSIC_SIZE || size == FD_SIZE) {
        memcpy(&word, message, sizeof word);
        length = message[4];
        fits = size == CLASSIC_SIZE
            ? length <= CLASSIC_BYTES
            : bstm_is_fd_length(length) && !(word & (REMOTE_FLAG | ERROR_FLAG));
    }
    if (!fits) {
        d->malformed++;
        return;
    }
    const int error = (word & ERROR_FLAG) != 0;
    const int remote = !error && (word & REMOTE_FLAG) != 0;
    if (!error && !remote && !is_wanted(d, word)) return;
    Record *const r = d->next + d->frames++;
    memset(r, 0, sizeof *r);
    r->stamp_ns = stamp_ns;
    r->bus = d->bus;
    r->error = (uint8_t)error;
    r->remote = (uint8_t)remote;
    r->extended = (uint8_t)(!error && (word & EXTENDED_FLAG) != 0);
    r->id = word & (error || r->extended ? EXTENDED_MASK : STANDARD_MASK);
    d->errors += error;
    /* the length of a remote frame is of the one it asks for: it has none */
    if (remote) return;
    r->length = (uint8_t)length;
    memcpy(r->data, message + HEAD_SIZE, length);
}

static void drain(Drain *d)
{
    struct mmsghdr header[BATCH];
    struct iovec piece[BATCH];
    Ancillary ancillary[BATCH];
    uint8_t message[BATCH][READ_SIZE];
    Py_ssize_t left = d->limit;
    while (left > 0) {
        const unsigned asked = left < BATCH ? (unsigned)left : BATCH;
        for (unsigned i = 0; i < asked; i++) {
            piece[i].iov_base = message[i];
            piece[i].iov_len = READ_SIZE;
            memset(&header[i], 0, sizeof header[i]);
            header[i].msg_hdr.msg_iov = &piece[i];
            header[i].msg_hdr.msg_iovlen = 1;
            header[i].msg_hdr.msg_control = &ancillary[i];
            header[i].msg_hdr.msg_controllen = sizeof ancillary[i];
        }
        const int came = recvmmsg(d->fd, header, asked, MSG_DONTWAIT, NULL);
        if (came <= 0) {
            if (came < 0 && errno == EINTR) continue;
            d->fault = came < 0 ? errno : EAGAIN;
            return;
        }
        for (int i = 0; i < came; i++)
            add_frame(d, &header[i].msg_hdr, message[i], header[i].msg_len);
        left -= came;
        /* fewer than asked: the next call finds it empty, or the error that
         * is in the way */
    }
}

const char bstm_receive_doc[] =
"receive(fd, store, first, limit, bus, only)\n\n"
"Read up to `limit` messages into the records of `store` from `first` on.\n"
"only: rising uint32 ids with their flags to let through, None for all.\n"
"Returns (frames, errno that ended the reading or 0 at the limit, malformed,\n"
"error frames, the kernel's count of drops or -1).";

PyObject *bstm_receive(PyObject *Py_UNUSED(self), PyObject *args)
{
    static const int wide[2] = {1, 4};
    Py_buffer view[2];
    Py_ssize_t first;
    int bus;
    Drain d = {.drops = -1};
    if (!PyArg_ParseTuple(args, "iw*nniz*", &d.fd, &view[0], &first, &d.limit,
                          &bus, &view[1]))
        return NULL;
    const int buffers = view[1].obj == NULL ? 1 : 2;
    if (bstm_widths(buffers, view, wide) < 0) return NULL;
    const int is_sum = first >= 0 && d.limit >= 0
        && d.limit <= PY_SSIZE_T_MAX - first;
    Record *const records =
        bstm_records(&view[0], first, is_sum ? first + d.limit : -1);
    if (records != NULL) {
        d.bus = bus;
        d.next = records + first;
        if (buffers == 2) {
            static const uint32_t none = 0;
            d.only_count = view[1].len / 4;
            d.only = d.only_count ? view[1].buf : &none;
        }
        Py_BEGIN_ALLOW_THREADS
        drain(&d);
        Py_END_ALLOW_THREADS
    }
    bstm_release(buffers, view);
    if (records == NULL) return NULL;
    return Py_BuildValue("ninnL", d.frames, d.fault, d.malformed, d.errors,
                         (long long)d.drops);
}
#endif

static PyMethodDef methods[] = {
    {"scan", bstm_scan, METH_VARARGS, bstm_scan_doc},
    {"extract", bstm_extract, METH_VARARGS, bstm_extract_doc},
#ifdef __linux__
    {"receive", bstm_receive, METH_VARARGS, bstm_receive_doc},
#endif
    {"place_in_time", bstm_place_in_time, METH_VARARGS,
     bstm_place_in_time_doc},
    {"sort", bstm_sort, METH_VARARGS, bstm_sort_doc},
    {"take", bstm_take, METH_VARARGS, bstm_take_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_bus",
    "Compiled reading of logs and live frames, and of samples from them.", -1,
    methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__bus(void)
{
    PyObject *const found = PyModule_Create(&module);
    if (found != NULL
        && PyModule_AddStringConstant(found, "SOURCES", BSTM_SOURCES) < 0) {
        Py_DECREF(found);
        return NULL;
    }
    return found;
}
