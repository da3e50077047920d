/* A USB device of libumockdev whose ioctls another process answers.
 *
 * Run under umockdev-wrapper, with a stream socket that the other process listens on, and commands on
 * stdin:
 *
 *     testbed SOCKET
 *     add SYSPATH NODE LENGTH\n  and LENGTH bytes of umockdev's description: the device is attached
 *     remove SYSPATH\n           it has gone
 *
 * Each command is answered by a line on stdout; the first line, before any, is the testbed's directory,
 * which a program under test needs as UMOCKDEV_DIR. It ends with stdin.
 *
 * Over the socket, numbers in this machine's order:
 *
 *     question  u32 what, u32 length, bytes         what: the number of the usbfs ioctl, _IOC_NR
 *     answer    i32 result, u32 length, bytes       result: of the ioctl, or -errno
 *
 * SUBMITURB asks with u64 address of the URB, u8 type, u8 endpoint, u16 0, u32 flags, u32 buffer length,
 * and the buffer where it goes to the device (a control transfer: always, its first 8 bytes are the
 * setup packet). REAPURBNDELAY is answered with u64 address, i32 status, u32 actual length, and the bytes
 * that go to the host. DISCARDURB asks with the u64 address. Any other ioctl asks with its argument, and
 * is answered with what the argument becomes. */

#include <errno.h>
#include <linux/usbdevice_fs.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <umockdev.h>

static int peer;
static UMockdevTestbed *testbed;
static UMockdevIoctlBase *handler;
/* URBs that the client has submitted and not reaped, by their address there. */
static GHashTable *urbs;

struct urb {
    UMockdevIoctlData *urb;
    UMockdevIoctlData *buffer;
};

static void forget_urb(gpointer data)
{
    struct urb *urb = data;
    umockdev_ioctl_data_unref(urb->urb);
    if (urb->buffer)
        umockdev_ioctl_data_unref(urb->buffer);
    g_free(urb);
}

static void all(int in, void *data, size_t length)
{
    for (char *at = data; length > 0;) {
        ssize_t done = in ? read(peer, at, length) : write(peer, at, length);
        if (done <= 0)
            exit(0); /* the other process has ended */
        at += done;
        length -= done;
    }
}

/* Asks the other process; the answer's bytes are the caller's to free. */
static int32_t ask(uint32_t what, const void *head, uint32_t head_length, const void *data,
                   uint32_t data_length, uint8_t **answer, uint32_t *answer_length)
{
    uint32_t question[2] = {what, head_length + data_length};
    all(0, question, sizeof question);
    all(0, (void *)head, head_length);
    all(0, (void *)data, data_length);
    struct {
        int32_t result;
        uint32_t length;
    } told;
    all(1, &told, sizeof told);
    *answer = g_malloc(told.length + 1);
    *answer_length = told.length;
    all(1, *answer, told.length);
    return told.result;
}

static void complete(UMockdevIoctlClient *client, int32_t result)
{
    if (result < 0)
        umockdev_ioctl_client_complete(client, -1, -result);
    else
        umockdev_ioctl_client_complete(client, result, 0);
}

static int32_t submit(UMockdevIoctlData *arg)
{
    UMockdevIoctlData *data = umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_urb), NULL);
    if (!data)
        return -EFAULT;
    const struct usbdevfs_urb *urb = (void *)data->data;
    struct {
        uint64_t address;
        uint8_t type, endpoint;
        uint16_t zero;
        uint32_t flags, length;
    } __attribute__((packed)) head = {data->client_addr, urb->type, urb->endpoint, 0,
                                      urb->flags, urb->buffer_length};
    UMockdevIoctlData *buffer = NULL;
    if (urb->buffer_length > 0) {
        buffer = umockdev_ioctl_data_resolve(data, offsetof(struct usbdevfs_urb, buffer),
                                             urb->buffer_length, NULL);
        if (!buffer) {
            umockdev_ioctl_data_unref(data);
            return -EFAULT;
        }
    }
    int sends = urb->type == USBDEVFS_URB_TYPE_CONTROL || !(urb->endpoint & 0x80);
    uint8_t *answer;
    uint32_t length;
    int32_t result = ask(_IOC_NR(USBDEVFS_SUBMITURB), &head, sizeof head,
                         sends && buffer ? buffer->data : NULL, sends ? head.length : 0, &answer,
                         &length);
    g_free(answer);
    struct urb *kept = g_new0(struct urb, 1);
    kept->urb = data;
    kept->buffer = buffer;
    if (result < 0)
        forget_urb(kept);
    else
        g_hash_table_replace(urbs, (gpointer)(uintptr_t)head.address, kept);
    return result;
}

static int32_t reap(UMockdevIoctlData *arg)
{
    uint8_t *answer;
    uint32_t length;
    int32_t result = ask(_IOC_NR(USBDEVFS_REAPURBNDELAY), NULL, 0, NULL, 0, &answer, &length);
    struct {
        uint64_t address;
        int32_t status;
        uint32_t actual;
    } told;
    if (result < 0 || length < sizeof told) {
        g_free(answer);
        return result < 0 ? result : -EPROTO;
    }
    memcpy(&told, answer, sizeof told);
    gpointer key = (gpointer)(uintptr_t)told.address;
    struct urb *urb = g_hash_table_lookup(urbs, key);
    UMockdevIoctlData *pointer = umockdev_ioctl_data_resolve(arg, 0, sizeof(gpointer), NULL);
    if (!urb || !pointer) {
        g_free(answer);
        return -EFAULT;
    }
    length -= sizeof told;
    if (length > 0 && urb->buffer) {
        /* Behind the setup packet of a control transfer. */
        const struct usbdevfs_urb *head = (void *)urb->urb->data;
        uint32_t at = head->type == USBDEVFS_URB_TYPE_CONTROL ? 8 : 0;
        if (at + length <= (uint32_t)urb->buffer->data_len)
            umockdev_ioctl_data_update(urb->buffer, at, answer + sizeof told, length);
    }
    umockdev_ioctl_data_update(urb->urb, offsetof(struct usbdevfs_urb, status),
                               (guint8 *)&told.status, sizeof told.status);
    umockdev_ioctl_data_update(urb->urb, offsetof(struct usbdevfs_urb, actual_length),
                               (guint8 *)&told.actual, sizeof told.actual);
    umockdev_ioctl_data_set_ptr(pointer, 0, urb->urb);
    umockdev_ioctl_data_unref(pointer);
    g_hash_table_remove(urbs, key);
    g_free(answer);
    return 0;
}

static int32_t other(UMockdevIoctlData *arg, unsigned long request)
{
    uint32_t size = _IOC_SIZE(request);
    UMockdevIoctlData *data = size ? umockdev_ioctl_data_resolve(arg, 0, size, NULL) : NULL;
    uint8_t *answer;
    uint32_t length;
    int32_t result = ask(_IOC_NR(request), NULL, 0, data ? data->data : NULL, data ? size : 0,
                         &answer, &length);
    if (data && length > 0 && length <= size)
        umockdev_ioctl_data_update(data, 0, answer, length);
    if (data)
        umockdev_ioctl_data_unref(data);
    g_free(answer);
    return result;
}

static gboolean on_ioctl(UMockdevIoctlBase *base, UMockdevIoctlClient *client, gpointer user)
{
    (void)base, (void)user;
    unsigned long request = umockdev_ioctl_client_get_request(client);
    UMockdevIoctlData *arg = umockdev_ioctl_client_get_arg(client);
    if (_IOC_TYPE(request) != 'U')
        return FALSE;
    switch (_IOC_NR(request)) {
    case _IOC_NR(USBDEVFS_SUBMITURB):
        complete(client, submit(arg));
        break;
    case _IOC_NR(USBDEVFS_REAPURBNDELAY):
        complete(client, reap(arg));
        break;
    case _IOC_NR(USBDEVFS_DISCARDURB): {
        /* Its argument is the address itself. */
        uint64_t address = *(gulong *)arg->data;
        uint8_t *answer;
        uint32_t length;
        int32_t result = ask(_IOC_NR(request), &address, sizeof address, NULL, 0, &answer, &length);
        g_free(answer);
        complete(client, result);
        break;
    }
    default:
        complete(client, other(arg, request));
    }
    return TRUE;
}

static gboolean on_command(GIOChannel *channel, GIOCondition condition, gpointer loop)
{
    (void)condition;
    gchar *line = NULL;
    if (g_io_channel_read_line(channel, &line, NULL, NULL, NULL) != G_IO_STATUS_NORMAL) {
        g_main_loop_quit(loop);
        return FALSE;
    }
    char path[256], node[256];
    unsigned length;
    GError *error = NULL;
    if (sscanf(line, "add %255s %255s %u", path, node, &length) == 3) {
        gchar *text = g_malloc0(length + 1);
        gsize got = 0;
        g_io_channel_read_chars(channel, text, length, &got, NULL);
        if (got == length && umockdev_testbed_add_from_string(testbed, text, &error))
            umockdev_testbed_attach_ioctl(testbed, node, handler, &error);
        g_free(text);
    } else if (sscanf(line, "remove %255s", path) == 1) {
        umockdev_testbed_remove_device(testbed, path);
    }
    puts(error ? error->message : "done");
    fflush(stdout);
    g_clear_error(&error);
    g_free(line);
    return TRUE;
}

int main(int argc, char **argv)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (argc != 2 || strlen(argv[1]) >= sizeof address.sun_path) {
        fputs("usage: umockdev-wrapper testbed SOCKET\n", stderr);
        return 2;
    }
    strcpy(address.sun_path, argv[1]);
    peer = socket(AF_UNIX, SOCK_STREAM, 0);
    if (peer < 0 || connect(peer, (struct sockaddr *)&address, sizeof address) < 0) {
        perror(argv[1]);
        return 1;
    }
    testbed = umockdev_testbed_new();
    handler = umockdev_ioctl_base_new();
    urbs = g_hash_table_new_full(NULL, NULL, NULL, forget_urb);
    g_signal_connect(handler, "handle-ioctl", G_CALLBACK(on_ioctl), NULL);
    gchar *root = umockdev_testbed_get_root_dir(testbed);
    puts(root);
    fflush(stdout);
    g_free(root);

    GMainLoop *loop = g_main_loop_new(NULL, FALSE);
    GIOChannel *commands = g_io_channel_unix_new(0);
    g_io_channel_set_encoding(commands, NULL, NULL);
    g_io_add_watch(commands, G_IO_IN | G_IO_HUP, on_command, loop);
    g_main_loop_run(loop);
    g_object_unref(handler);
    g_object_unref(testbed);
    return 0;
}
