/* A plugin that can end its process in many ways, for the tests of the host. Built with
 *   -DNAME=id                 the plugin's id
 *   -DKIND=LUMISTACK_KIND_... one of the four kinds
 *   -DIN_ENTRY="what"         the fault of the entry function, such as "abort"; none by default
 * The parameter `fault` is "when:what", a place and its fault, such as "submit:abort". The places
 * are functions, except "before" and "submit": the times in `submit` before and after it opens a
 * file. The place "make" is every function that makes data. The values "fetch" and "slow" of the
 * parameter select more work in `submit`, without a fault.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "lumistack_plugin.h"

#define TEXT(text) {(const uint8_t *)(text), sizeof(text) - 1}
#define STRING_(word) #word
#define STRING(word) STRING_(word)
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#ifndef IN_ENTRY
#define IN_ENTRY ""
#endif

static const LumistackHostServices *host;
static char fault[64];

static int deeper(int depth) {
    volatile char room[4096];
    room[depth % 4096] = (char)depth;
    return deeper(depth + 1) + room[(depth + 1) % 4096];
}

/* Creates a file in the test's folder, which proves that this code ran. */
static void mark(const char *name) {
    const char *folder = getenv("LUMISTACK_TEST_MARKS");
    if (!folder) return;
    char path[1024];
    snprintf(path, sizeof path, "%s/%s-%s", folder, STRING(NAME), name);
    FILE *file = fopen(path, "w");
    if (!file) return;
    fprintf(file, "%ld\n", (long)getpid());
    fclose(file);
}

static void misbehave(const char *what) {
    if (!strcmp(what, "abort")) abort();
    if (!strcmp(what, "segfault")) *(volatile int *)8 = 1;
    if (!strcmp(what, "overflow")) exit(deeper(0));
    if (!strcmp(what, "exit")) exit(0);
    if (!strcmp(what, "kill")) raise(SIGKILL);
    if (!strcmp(what, "say and abort")) {
        fprintf(stderr, "first\nout of ink\n");
        abort();
    }
    if (!strcmp(what, "hang")) {
        mark("hangs");
        for (;;) pause();
    }
    if (!strcmp(what, "spin"))
        for (volatile int i = 0;; i++) {}
    if (!strcmp(what, "print")) {
        for (int i = 0; i < 2500; i++) printf("printed by a plugin, line %d\n", i);
        fflush(stdout);
        ssize_t written = write(1, "and past the library\n", 21);
        char nothing;
        if (written != 21 || read(0, &nothing, 1) != 0) abort();
    }
    /* the pipes to the program are among these descriptors */
    if (!strcmp(what, "scribble")) {
        for (int fd = 3; fd < 64; fd++)
            if (write(fd, "this is no frame of any protocol", 32) < 0) continue;
        for (;;) pause();
    }
    if (!strcmp(what, "close all")) {
        /* Wait until the thread that reads messages blocks in its next read. During the read the
           thread does not notice that its pipe is closed. If the pipe were closed before the read,
           the thread would end the process. */
        usleep(100000);
        for (int fd = 3; fd < 64; fd++) close(fd);
        for (;;) pause();
    }
    /* the forked process keeps the pipes open after the abort */
    if (!strcmp(what, "fork and abort")) {
        if (fork() == 0) {
            sleep(20);
            _exit(0);
        }
        abort();
    }
}

static void at(const char *when) {
    size_t length = strlen(when);
    if (!strncmp(fault, when, length) && fault[length] == ':') misbehave(fault + length + 1);
}

/* Stores the host's services, and copies the value of the parameter `fault` */
static LumistackStatus started(const LumistackHostServices *services, LumistackStr params) {
    host = services;
    const char *key = "\"fault\":\"";
    char text[512] = {0};
    memcpy(text, params.ptr, params.len < sizeof text ? params.len : sizeof text - 1);
    const char *value = strstr(text, key);
    if (value) {
        value += strlen(key);
        size_t length = strcspn(value, "\"");
        if (length >= sizeof fault) return LUMISTACK_STATUS_REFUSED;
        memcpy(fault, value, length);
        fault[length] = 0;
    }
    return LUMISTACK_STATUS_OK;
}

static LumistackStatus open_(const LumistackHostServices *services, LumistackStr params, LumistackStr display,
                             void **instance, const LumistackErrorSink *error) {
    (void)display, (void)error;
    *instance = NULL;
    LumistackStatus status = started(services, params);
    at("open");
    return status;
}

/* Fetches and releases every layer and frame four times. Writes the number of fetched bytes and
   this process's peak of memory (kB) into `line`. */
static int fetch(const LumistackData *data, char *line, size_t size) {
    unsigned long long bytes = 0;
    for (int again = 0; again < 4; again++)
        for (size_t layer = 0;; layer++) {
            size_t frame = 0;
            for (;; frame++) {
                LumistackPlane plane = {.size = sizeof plane};
                if (data->layer_plane(data->context, layer, frame, &plane, NULL) != LUMISTACK_STATUS_OK) break;
                bytes += plane.shape[0] * (unsigned long long)plane.strides[0];
                if (plane.release) plane.release(plane.owner);
            }
            if (frame == 0) break;
        }
    char status[256], most[64] = "0";
    FILE *file = fopen("/proc/self/status", "r");
    while (file && fgets(status, sizeof status, file)) sscanf(status, "VmHWM: %63s", most);
    if (file) fclose(file);
    return snprintf(line, size, "%llu %s", bytes, most);
}

static LumistackStatus submit(void *instance, const LumistackTime *time, const LumistackData *data,
                              const LumistackErrorSink *error) {
    (void)instance, (void)time;
    uint64_t file;
    LumistackStr name = TEXT("a.txt");
    at("before");
    LumistackStatus status = host->file_open(host->context, name, &file, error);
    if (status != LUMISTACK_STATUS_OK) return status;
    at("submit");
    char line[128] = "written";
    int length = 7;
    if (!strcmp(fault, "fetch")) length = fetch(data, line, sizeof line);
    /* takes longer than the limit of silence, but calls the host all the time */
    if (!strcmp(fault, "slow"))
        for (int i = 0; i < 15; i++) {
            usleep(200000);
            host->is_cancelled(host->context);
        }
    LumistackBytes bytes = {(const uint8_t *)line, (size_t)length};
    status = host->file_append(host->context, file, bytes, error);
    return status == LUMISTACK_STATUS_OK ? host->file_commit(host->context, file, error) : status;
}

static LumistackStatus finish(void *instance, const LumistackErrorSink *error) {
    (void)instance, (void)error;
    at("finish");
    return LUMISTACK_STATUS_OK;
}

static void close_(void *instance) {
    (void)instance;
    at("close");
}

static LumistackStatus import(const LumistackHostServices *services, LumistackStr params, LumistackStr file,
                              const LumistackAssets *assets, const LumistackByteSink *scene,
                              const LumistackErrorSink *error) {
    (void)file, (void)assets;
    LumistackStatus status = started(services, params);
    at("make");
    LumistackBytes bytes = {(const uint8_t *)"{}", 2};
    return status == LUMISTACK_STATUS_OK ? scene->write(scene->context, bytes, error) : status;
}

static LumistackStatus make_field(const LumistackHostServices *services, LumistackStr params, LumistackStr display,
                                  const LumistackTime *time, const LumistackFieldSink *field,
                                  const LumistackErrorSink *error) {
    (void)display, (void)time, (void)field, (void)error;
    LumistackStatus status = started(services, params);
    at("make");
    return status;
}

static LumistackStatus make_stack(const LumistackHostServices *services, LumistackStr params, LumistackStr display,
                                  const LumistackTime *time, const LumistackData *data,
                                  const LumistackStackSink *stack, const LumistackErrorSink *error) {
    (void)display, (void)time, (void)data, (void)stack, (void)error;
    LumistackStatus status = started(services, params);
    at("make");
    return status;
}

static const LumistackOutputVtable output = {
    .size = sizeof output, .open = open_, .submit = submit, .run = NULL, .finish = finish, .close = close_};
static const LumistackImporterVtable importer = {
    .size = sizeof importer, .extensions = TEXT("hostile"), .import = import};
static const LumistackSourceVtable source = {.size = sizeof source, .make = make_field};
static const LumistackNodeVtable node = {.size = sizeof node, .make = make_stack};

#define TABLE                                                     \
    (KIND == LUMISTACK_KIND_OUTPUT     ? (const void *)&output    \
     : KIND == LUMISTACK_KIND_IMPORTER ? (const void *)&importer  \
     : KIND == LUMISTACK_KIND_SOURCE   ? (const void *)&source    \
                                       : (const void *)&node)

static LumistackDescriptor descriptor = {
    .abi_major = LUMISTACK_ABI_MAJOR,
    .abi_minor = LUMISTACK_ABI_MINOR,
    .size = sizeof descriptor,
    .kind = KIND,
    .ports = KIND == LUMISTACK_KIND_IMPORTER ? LUMISTACK_PORT_FILE
             : KIND == LUMISTACK_KIND_NODE   ? LUMISTACK_PORT_LIGHT_FIELD
             : KIND == LUMISTACK_KIND_SOURCE ? 0
                                             : LUMISTACK_PORT_LAYER_STACK,
    .id = TEXT(STRING(NAME)),
    .version = TEXT("1.0.0"),
    .doc = TEXT("Ends its process in the way that its parameter selects."),
    .schema_json =
        TEXT("{\"params\": [{\"name\": \"fault\", \"kind\": \"text\", \"default\": \"\", \"help\": \"The time and the kind of the end.\"}]}"),
};

__attribute__((visibility("default"))) const LumistackDescriptor *JOIN(lumistack_plugin_entry_, NAME)(void) {
    mark("loaded");
    misbehave(IN_ENTRY);
    descriptor.vtable = TABLE;
    return &descriptor;
}
