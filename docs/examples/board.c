/* A small board: sends a temperature each second and switches a light when it is told to.
 *
 * Plain C and POSIX sockets; neither ROS nor a library. Run it beside `rce up --dev`:
 *
 *     cc -std=c99 -Wall -o board docs/examples/board.c
 *     ./board 127.0.0.1 9010 "$(printf testUser | sha256sum | cut -c1-64)"
 *
 * 9010 is the port of the Robot endpoint, which `rce up` prints; a board that knows the Master only asks it for the
 * address first (docs/protocol.md, "Request the address"). Then connect its interfaces to those of another robot or of
 * an environment, for example `board/temperature` and `board/light`.
 *
 * A WebSocket (RFC 6455) is an HTTP request, then frames: two bytes of header, the length, and the text, which a client
 * masks with four bytes. A board with TLS replaces `read` and `write` by those of its TLS library.
 */
#define _POSIX_C_SOURCE 200809L
#include <netdb.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { TEXT = 1, CLOSE = 8, PING = 9, PONG = 10, MAX_TEXT = 4096 };

static int line; /* the socket */

static void fail(const char *what) {
    fprintf(stderr, "board: %s\n", what);
    exit(1);
}

static void read_all(void *into, size_t size) {
    for (size_t done = 0; done < size;) {
        ssize_t count = read(line, (char *)into + done, size - done);
        if (count <= 0) fail("the platform closed the connection");
        done += (size_t)count;
    }
}

static void write_all(const void *from, size_t size) {
    for (size_t done = 0; done < size;) {
        ssize_t count = write(line, (const char *)from + done, size - done);
        if (count <= 0) fail("the connection is broken");
        done += (size_t)count;
    }
}

static void dial(const char *host, const char *port) {
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM}, *found;
    if (getaddrinfo(host, port, &hints, &found)) fail("there is no such host");
    for (struct addrinfo *each = found; each; each = each->ai_next) {
        line = socket(each->ai_family, each->ai_socktype, each->ai_protocol);
        if (line >= 0 && !connect(line, each->ai_addr, each->ai_addrlen)) {
            freeaddrinfo(found);
            return;
        }
        if (line >= 0) close(line);
    }
    fail("no Robot endpoint answers at this address");
}

static void open_websocket(const char *host, const char *port, const char *password) {
    char text[MAX_TEXT];
    int size = snprintf(text, sizeof text,
                        "GET /?userID=testUser&robotID=board&password=%s HTTP/1.1\r\n"
                        "Host: %s:%s\r\n"
                        "Upgrade: websocket\r\n"
                        "Connection: Upgrade\r\n"
                        "Sec-WebSocket-Version: 13\r\n"
                        "Sec-WebSocket-Key: dGhlIGJvYXJkIGlzIHVwIQ==\r\n\r\n",
                        password, host, port);
    if (size >= (int)sizeof text) fail("the password is too long");
    write_all(text, (size_t)size);
    size_t end = 0;
    do {
        if (end == sizeof text - 1) fail("the answer is too long");
        read_all(text + end++, 1);
        text[end] = 0;
    } while (end < 4 || strcmp(text + end - 4, "\r\n\r\n"));
    if (strncmp(text, "HTTP/1.1 101 ", 13)) fail(text); /* the first line has the reason */
}

static void send_frame(int kind, const char *text, size_t size) {
    uint8_t head[8] = {(uint8_t)(0x80 | kind)};
    size_t length = size < 126 ? 2 : 4;
    head[1] = (uint8_t)(0x80 | (size < 126 ? size : 126));
    if (length == 4) head[2] = (uint8_t)(size >> 8), head[3] = (uint8_t)size;
    uint8_t *mask = head + length, body[MAX_TEXT];
    for (int i = 0; i < 4; i++) mask[i] = (uint8_t)rand();
    for (size_t i = 0; i < size; i++) body[i] = (uint8_t)text[i] ^ mask[i % 4];
    write_all(head, length + 4);
    write_all(body, size);
}

static void send_text(const char *text) {
    send_frame(TEXT, text, strlen(text));
}

/* Read a frame into `text` and return its kind. The platform sends frames of one piece, without a mask. */
static int read_frame(char text[MAX_TEXT]) {
    uint8_t head[2], more[2];
    read_all(head, 2);
    size_t size = head[1] & 0x7f;
    if (size == 126) {
        read_all(more, 2);
        size = (size_t)more[0] << 8 | more[1];
    }
    if (size >= MAX_TEXT || (head[1] & 0x7f) == 127) fail("a message is too long for this board");
    read_all(text, size);
    text[size] = 0;
    if ((head[0] & 0x0f) == PING) send_frame(PONG, text, size);
    return head[0] & 0x0f;
}

static void add_interface(const char *tag, const char *kind, const char *type) {
    char text[MAX_TEXT];
    snprintf(text, sizeof text,
             "{\"type\": \"CN\", \"data\": {\"addInterfaces\": [{\"endpointTag\": \"board\", \"interfaceTag\": \"%s\","
             " \"interfaceType\": \"%s\", \"className\": \"%s\"}]}}",
             tag, kind, type);
    send_text(text);
}

static void send_temperature(double celsius) {
    char text[MAX_TEXT];
    snprintf(text, sizeof text,
             "{\"type\": \"DM\", \"data\": {\"iTag\": \"temperature\", \"type\": \"std_msgs/Float64\", \"msgID\": \"\","
             " \"msg\": {\"data\": %.2f}}}",
             celsius);
    send_text(text);
}

int main(int argc, char **argv) {
    if (argc != 4) fail("usage: board HOST PORT PASSWORD_SHA256");
    dial(argv[1], argv[2]);
    open_websocket(argv[1], argv[2], argv[3]);
    add_interface("temperature", "SubscriberConverter", "std_msgs/Float64"); /* from the board */
    add_interface("light", "PublisherConverter", "std_msgs/Bool");           /* to the board */
    setvbuf(stdout, NULL, _IOLBF, 0);
    printf("connected\n");
    double celsius = 20.0;
    time_t sent = 0;
    for (char text[MAX_TEXT];;) {
        struct pollfd readable = {.fd = line, .events = POLLIN};
        if (poll(&readable, 1, 100) > 0) {
            int kind = read_frame(text);
            if (kind == CLOSE) fail("the platform closed the connection");
            if (kind == TEXT && strstr(text, "\"iTag\":\"light\"") && strstr(text, "\"msg\""))
                printf("light %s\n", strstr(text, "\"data\":true") ? "on" : "off");
            if (kind == TEXT && strstr(text, "\"type\":\"ER\"")) fprintf(stderr, "board: %s\n", text);
        }
        if (time(NULL) != sent) {
            sent = time(NULL);
            send_temperature(celsius += 0.25);
        }
    }
}
