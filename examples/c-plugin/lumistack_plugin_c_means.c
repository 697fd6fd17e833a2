/* Output plugin `c_means`, in C: writes the mean transmittance of every layer and frame as text.
 *
 *   cc -shared -fPIC -O2 -I crates/plugin-abi/include -o target/liblumistack_plugin_c_means.so examples/c-plugin/lumistack_plugin_c_means.c
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lumistack_plugin.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Passes a constant text to the host without a copy. */
#define TEXT(text) {(const uint8_t *)(text), sizeof(text) - 1}

typedef struct {
    const LumistackHostServices *host;
} CMeans;

static LumistackStatus fail(const LumistackErrorSink *error, LumistackStatus status, const char *reason) {
    LumistackStr text = {(const uint8_t *)reason, strlen(reason)};
    if (error) error->write(error->context, text);
    return status;
}

/* The plugin has no parameters, so it refuses any JSON text but an empty object. The error quotes the refused text. */
static LumistackStatus open_(const LumistackHostServices *host, LumistackStr params, LumistackStr display,
                             void **instance, const LumistackErrorSink *error) {
    (void)display;
    if (host->size < sizeof *host) return fail(error, LUMISTACK_STATUS_REFUSED, "the program is older than the plugin");
    if (params.len != 2 || memcmp(params.ptr, "{}", 2) != 0) {
        char reason[512];
        snprintf(reason, sizeof reason, "expected no parameters, found %.*s",
                 (int)(params.len < 400 ? params.len : 400), (const char *)params.ptr);
        return fail(error, LUMISTACK_STATUS_REFUSED, reason);
    }
    CMeans *means = malloc(sizeof *means);
    if (!means) return fail(error, LUMISTACK_STATUS_FAILED, "no memory");
    means->host = host;
    *instance = means;
    return LUMISTACK_STATUS_OK;
}

/* Returns one value of a plane. Strides are in bytes and may be negative, and values need not be aligned. */
static float value_at(const LumistackPlane *plane, size_t row, size_t col, size_t channel) {
    const char *place = (const char *)plane->data + (ptrdiff_t)row * plane->strides[0] +
                        (ptrdiff_t)col * plane->strides[1] + (ptrdiff_t)channel * plane->strides[2];
    float value;
    memcpy(&value, place, sizeof value);
    return value;
}

static double mean_of(const LumistackPlane *plane) {
    double sum = 0;
    for (size_t row = 0; row < plane->shape[0]; row++)
        for (size_t col = 0; col < plane->shape[1]; col++)
            for (size_t channel = 0; channel < plane->shape[2]; channel++) sum += value_at(plane, row, col, channel);
    return sum / ((double)plane->shape[0] * (double)plane->shape[1] * (double)plane->shape[2]);
}

/* Writes the means of one layer stack. Several threads may call this function at once, so the plugin keeps no state. */
static LumistackStatus submit(void *instance, const LumistackTime *time, const LumistackData *data,
                              const LumistackErrorSink *error) {
    const LumistackHostServices *host = ((CMeans *)instance)->host;
    if (data->port != LUMISTACK_PORT_LAYER_STACK) return fail(error, LUMISTACK_STATUS_REFUSED, "expected a layer stack, found other data");
    char name[64];
    int length = snprintf(name, sizeof name, "means_%04llu.txt", (unsigned long long)time->index);
    LumistackStr path = {(const uint8_t *)name, (size_t)length};
    uint64_t file;
    LumistackStatus status = host->file_open(host->context, path, &file, error);
    if (status != LUMISTACK_STATUS_OK) return status;
    /* The host refuses layers and frames that do not exist, which ends the loops. (data.description_json states their numbers, too.) */
    for (size_t layer = 0;; layer++) {
        size_t frame = 0;
        for (;; frame++) {
            if (host->is_cancelled(host->context)) {
                host->file_abort(host->context, file, NULL);
                return fail(error, LUMISTACK_STATUS_CANCELLED, "cancelled");
            }
            LumistackPlane plane = {.size = sizeof plane};
            status = data->layer_plane(data->context, layer, frame, &plane, NULL);
            if (status == LUMISTACK_STATUS_REFUSED) break;
            if (status != LUMISTACK_STATUS_OK) {
                host->file_abort(host->context, file, NULL);
                return fail(error, status, "a layer cannot be read");
            }
            char line[128];
            int written = snprintf(line, sizeof line, "layer %zu frame %zu mean %.6f\n", layer, frame, mean_of(&plane));
            if (plane.release) plane.release(plane.owner);
            LumistackBytes bytes = {(const uint8_t *)line, (size_t)written};
            status = host->file_append(host->context, file, bytes, error);
            if (status != LUMISTACK_STATUS_OK) {
                host->file_abort(host->context, file, NULL);
                return status;
            }
        }
        if (frame == 0) break;
    }
    return host->file_commit(host->context, file, error);
}

static LumistackStatus finish(void *instance, const LumistackErrorSink *error) {
    (void)instance, (void)error;
    return LUMISTACK_STATUS_OK;
}

static void close_(void *instance) {
    free(instance);
}

static const LumistackOutputVtable VTABLE = {
    .size = sizeof VTABLE, .open = open_, .submit = submit, .run = NULL, .finish = finish, .close = close_};

static const LumistackDescriptor DESCRIPTOR = {
    .abi_major = LUMISTACK_ABI_MAJOR,
    .abi_minor = LUMISTACK_ABI_MINOR,
    .size = sizeof DESCRIPTOR,
    .kind = LUMISTACK_KIND_OUTPUT,
    .ports = LUMISTACK_PORT_LAYER_STACK,
    .id = TEXT("c_means"),
    .version = TEXT("1.0.0"),
    .doc = TEXT("Writes the mean transmittance of every layer and frame as text. A sample in C."),
    .schema_json = TEXT("{\"params\": []}"),
    .vtable = &VTABLE,
};

/* The name of this function must end with the plugin's id. The library's file may have another name:
 * any id (lower-case letters, digits, underscores) may follow `lumistack_plugin_`. */
EXPORT const LumistackDescriptor *lumistack_plugin_entry_c_means(void) {
    return &DESCRIPTOR;
}
