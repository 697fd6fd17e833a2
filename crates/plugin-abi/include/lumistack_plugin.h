/* Plugins of Lumistack, for C. Made from the Rust types of lumistack-plugin-abi; do not edit.
 *
 * A shared library lumistack_plugin_NAME (with the system's prefix and suffix) exports for every plugin ID that it holds
 *
 *     const LumistackDescriptor *lumistack_plugin_entry_ID(void);
 *
 * A struct starts with its own size in bytes (a descriptor with its version) and only ever grows at the end: set `size` to `sizeof` of what
 * you hand out, and read no further than the `size` of what you are given. Texts are UTF-8 with a length, never null-terminated.
 * Nothing may unwind into the caller. docs/PLUGINS.md shows a whole plugin.
 */

#ifndef LUMISTACK_PLUGIN_H
#define LUMISTACK_PLUGIN_H

#include <stddef.h>
#include <stdint.h>

/**
 * Version of everything that already exists. It stays 0 until every first-party plugin has lived with it.
 */
#define LUMISTACK_ABI_MAJOR 0

/**
 * Version of what was added at the ends of structs.
 */
#define LUMISTACK_ABI_MINOR 4

/**
 * IEEE 754 binary32, native byte order.
 */
#define LUMISTACK_DTYPE_F32 1

/**
 * A parallel projection: `value` = slope s_x, s_y, and 0.
 */
#define LUMISTACK_VIEW_SLOPE 1

/**
 * A pinhole: `value` = eye x, y, z in display space, millimetres, z > 0.
 */
#define LUMISTACK_VIEW_EYE 2

/**
 * Makes scenes from files; see `ImporterVtable`.
 */
#define LUMISTACK_KIND_IMPORTER 1

/**
 * Makes light fields; see `SourceVtable`.
 */
#define LUMISTACK_KIND_SOURCE 2

/**
 * Turns light fields into layer stacks; see `NodeVtable`.
 */
#define LUMISTACK_KIND_NODE 3

/**
 * Takes what the graph makes and puts it somewhere; see `OutputVtable`.
 */
#define LUMISTACK_KIND_OUTPUT 4

/**
 * A validated scene.
 */
#define LUMISTACK_PORT_SCENE 1

/**
 * Linear radiance of many views.
 */
#define LUMISTACK_PORT_LIGHT_FIELD (1 << 1)

/**
 * The patterns of a tensor display.
 */
#define LUMISTACK_PORT_LAYER_STACK (1 << 2)

/**
 * A file that another part wrote.
 */
#define LUMISTACK_PORT_FILE (1 << 3)

/**
 * Something failed and the plugin goes on without it.
 */
#define LUMISTACK_LEVEL_ERROR 1

/**
 * The user should know.
 */
#define LUMISTACK_LEVEL_WARN 2

/**
 * The user may want to know.
 */
#define LUMISTACK_LEVEL_INFO 3

/**
 * For whoever develops the plugin.
 */
#define LUMISTACK_LEVEL_DEBUG 4

/**
 * Lent UTF-8 text.
 */
typedef struct LumistackStr {
  /**
   * First byte; not read when `len` is 0.
   */
  const uint8_t *ptr;
  /**
   * Number of bytes.
   */
  size_t len;
} LumistackStr;

/**
 * What a plugin is and what it takes. All texts live as long as the process.
 */
typedef struct LumistackDescriptor {
  /**
   * `ABI_MAJOR` of the plugin's build.
   */
  uint32_t abi_major;
  /**
   * `ABI_MINOR` of the plugin's build.
   */
  uint32_t abi_minor;
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * One of `kind`; says what `vtable` points to.
   */
  uint32_t kind;
  /**
   * Accepted input ports, bits of `port`: `FILE` for importers, none for sources, `LIGHT_FIELD` for nodes.
   */
  uint32_t ports;
  /**
   * Name in job files and on the command line: lower-case letters, digits and underscores, a letter first.
   */
  struct LumistackStr id;
  /**
   * Version of the plugin, `major.minor.patch`.
   */
  struct LumistackStr version;
  /**
   * What it does, for people; the first sentence stands in lists.
   */
  struct LumistackStr doc;
  /**
   * Parameters: `{"params": [{"name", "kind", "default", "min", "max", "options", "unit", "help"}, ...]}`.
   */
  struct LumistackStr schema_json;
  /**
   * Functions of its kind; see `kind`.
   */
  const void *vtable;
} LumistackDescriptor;

/**
 * Outcome of a call.
 */
typedef int32_t LumistackStatus;
/**
 * Done.
 */
#define LUMISTACK_STATUS_OK 0
/**
 * The call failed; the error text says why.
 */
#define LUMISTACK_STATUS_FAILED 1
/**
 * Stopped because the host asked to stop; nothing is wrong with the input.
 */
#define LUMISTACK_STATUS_CANCELLED 2
/**
 * Parameters or data that the callee does not take; the error text names them.
 */
#define LUMISTACK_STATUS_REFUSED 3
/**
 * The callee panicked; the error text is the panic's message.
 */
#define LUMISTACK_STATUS_PANICKED 4

/**
 * Takes the error text of one call. The caller provides it, so that no memory changes hands and calls from several threads do not
 * mix their texts.
 */
typedef struct LumistackErrorSink {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Passed to `write`.
   */
  void *context;
  /**
   * Copies `text`; a later text replaces an earlier one.
   */
  void (*write)(void *context, struct LumistackStr text);
} LumistackErrorSink;

/**
 * Lent bytes.
 */
typedef struct LumistackBytes {
  /**
   * First byte; not read when `len` is 0.
   */
  const uint8_t *ptr;
  /**
   * Number of bytes.
   */
  size_t len;
} LumistackBytes;

/**
 * A lent array of 1 to 4 axes, outermost first.
 */
typedef struct LumistackPlane {
  /**
   * Size of this struct in bytes; the one who wants a plane sets it.
   */
  size_t size;
  /**
   * First element. Elements need not be aligned.
   */
  const void *data;
  /**
   * One of `dtype`.
   */
  uint32_t dtype;
  /**
   * Number of axes in use.
   */
  uint32_t ndim;
  /**
   * Length of every axis; 1 beyond `ndim`.
   */
  size_t shape[4];
  /**
   * Bytes from one element to the next along every axis; may be negative or 0.
   */
  ptrdiff_t strides[4];
  /**
   * Passed to `release`.
   */
  void *owner;
  /**
   * Gives the plane back. Null: it is valid until the `submit` that fetched it returns, and nothing needs to be done.
   */
  void (*release)(void *owner);
} LumistackPlane;

/**
 * One time's data, lent until `submit` returns. Functions that do not fit `port` return `Status::REFUSED`. May be read from
 * several threads.
 */
typedef struct LumistackData {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * One bit of `port`: what this is.
   */
  uint32_t port;
  /**
   * Passed to every function.
   */
  const void *context;
  /**
   * Shapes and geometry. A layer stack: `{"port": "layer_stack", "brightness", "frames", "layers": [[rows, cols], ...] (rearmost
   * first), "emission": [bins_y, bins_x, lenslet_rows, lenslet_cols] or null, "target": geometry, "target_views": whether `view_plane` lends
   * the target's views, "target_depth": depth}`. A light field: `{"port":
   * "light_field", "geometry": geometry, "depth": depth}`, and for a node also `"seed"`, `"weights": {"per_view": [[...], ...]}` or `"per_ray"` (see `weight_plane`;
   * left out where all rays count alike), and `"start": {"brightness"}` where there are patterns to begin from, of the display's own
   * shape, which `layer_plane` and `emission_plane` lend. A depth, left out where nobody knows it: how deep the view [view rows / 2, view columns / 2]
   * sees, `{"rows", "cols", "z_mm": [row by row, millimetres towards the viewer, null where nothing is met]}`; it may be coarser than the views. A geometry: `{"rows", "cols", "pitch_mm", "projection": "oblique" | "perspective",
   * "distance_mm", "slope_x": [...], "slope_y": [...]}`.
   */
  struct LumistackStr description_json;
  /**
   * Transmittance `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1.
   */
  LumistackStatus (*layer_plane)(const void *context,
                                 size_t layer,
                                 size_t frame,
                                 struct LumistackPlane *plane,
                                 const struct LumistackErrorSink *error);
  /**
   * Emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a directional backlight, linear, 0..1.
   */
  LumistackStatus (*emission_plane)(const void *context,
                                    size_t frame,
                                    size_t bin_y,
                                    size_t bin_x,
                                    struct LumistackPlane *plane,
                                    const struct LumistackErrorSink *error);
  /**
   * Linear radiance `[row][col][rgb]` of one view of a light field, or of a layer stack's target where it has views.
   */
  LumistackStatus (*view_plane)(const void *context,
                                size_t view_y,
                                size_t view_x,
                                struct LumistackPlane *plane,
                                const struct LumistackErrorSink *error);
  /**
   * Weights `[row][col][1]`, not below 0, of the rays of one view, where the description says `"per_ray"`. Since version 0.3.
   */
  LumistackStatus (*weight_plane)(const void *context,
                                  size_t view_y,
                                  size_t view_x,
                                  struct LumistackPlane *plane,
                                  const struct LumistackErrorSink *error);
} LumistackData;

/**
 * A place to look at the display from.
 */
typedef struct LumistackView {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * One of `view`.
   */
  uint32_t kind;
  /**
   * Meaning by `kind`.
   */
  double value[3];
} LumistackView;

/**
 * Functions of the host; every one may be called from any thread, from `open` until `close` returns. They come as a table because
 * statics (loggers, allocators, thread pools) are separate in every library.
 */
typedef struct LumistackHostServices {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Passed to every function.
   */
  const void *context;
  /**
   * Reports a message; `level` is one of `level`.
   */
  void (*log)(const void *context, uint32_t level, struct LumistackStr message);
  /**
   * A stage of `total` steps of kind `unit` ("files") starts.
   */
  void (*progress_begin)(const void *context, struct LumistackStr stage, uint64_t total, struct LumistackStr unit);
  /**
   * Some steps are done; `note` is a short figure to show beside the bar, or empty.
   */
  void (*progress_advance)(const void *context, uint64_t steps, struct LumistackStr note);
  /**
   * The stage has ended.
   */
  void (*progress_end)(const void *context);
  /**
   * Nonzero once the user asked to stop; long work asks often and then returns `Status::CANCELLED`.
   */
  uint8_t (*is_cancelled)(const void *context);
  /**
   * Starts a file; `path` is relative to the output's folder, with `/` between its parts and no `..`. `*file` is its handle.
   */
  LumistackStatus (*file_open)(const void *context,
                               struct LumistackStr path,
                               uint64_t *file,
                               const struct LumistackErrorSink *error);
  /**
   * Adds bytes at the end of an open file.
   */
  LumistackStatus (*file_append)(const void *context,
                                 uint64_t file,
                                 struct LumistackBytes bytes,
                                 const struct LumistackErrorSink *error);
  /**
   * The file is whole. It appears in its place once the output has finished. The handle is gone.
   */
  LumistackStatus (*file_commit)(const void *context, uint64_t file, const struct LumistackErrorSink *error);
  /**
   * Drops the file; nothing of it remains. The handle is gone.
   */
  LumistackStatus (*file_abort)(const void *context, uint64_t file, const struct LumistackErrorSink *error);
  /**
   * The seen picture of a submitted layer stack from one place: emitted linear radiance
   * `[row][col][rgb]`, the mean over the area of each of the target's pixels, not divided by the stack's brightness. `data` is what `submit` was given; the plane is the plugin's to
   * release.
   */
  LumistackStatus (*simulate)(const void *context,
                              const struct LumistackData *data,
                              const struct LumistackView *view,
                              struct LumistackPlane *plane,
                              const struct LumistackErrorSink *error);
  /**
   * Tells an event to the driver of a presenter, as JSON of the plugin's own form. Since version 0.4.
   */
  void (*tell)(const void *context, struct LumistackStr event_json);
  /**
   * The port whose data an output will be given, a bit of `port`; 0 where the host does not say. Since version 0.4.
   */
  uint32_t port;
} LumistackHostServices;

/**
 * Place in a sequence.
 */
typedef struct LumistackTime {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Number of the time in this output, from 0; a still has only 0.
   */
  uint64_t index;
  /**
   * Time in the scene, seconds.
   */
  double seconds;
} LumistackTime;

/**
 * Functions of an output plugin. All but `run` and `command` must be there. `error` is where the text of a status other than
 * `Status::OK` goes; it may be null when the caller does not want it.
 */
typedef struct LumistackOutputVtable {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Starts an output. `params_json` is an object that holds any of the schema's parameters; `display_json` the display file as
   * JSON. `host` is valid until `close` returns. On success `*instance` is a handle for the other functions; otherwise it is
   * left alone and `close` is not called.
   */
  LumistackStatus (*open)(const struct LumistackHostServices *host,
                          struct LumistackStr params_json,
                          struct LumistackStr display_json,
                          void **instance,
                          const struct LumistackErrorSink *error);
  /**
   * Takes one time of the sequence. Called from any thread, also from several at once.
   */
  LumistackStatus (*submit)(void *instance,
                            const struct LumistackTime *time,
                            const struct LumistackData *data,
                            const struct LumistackErrorSink *error);
  /**
   * Presenters only, else null: runs on the main thread until the user closes the presentation or the host cancels. Meanwhile
   * every `submit` replaces what is presented: only the newest state counts.
   */
  LumistackStatus (*run)(void *instance, const struct LumistackErrorSink *error);
  /**
   * No more data will come. Called at most once, after every `submit` has returned.
   */
  LumistackStatus (*finish)(void *instance, const struct LumistackErrorSink *error);
  /**
   * Frees the handle. Called exactly once, last, from whatever state: without `finish` the output is abandoned.
   */
  void (*close)(void *instance);
  /**
   * Presenters that take commands, else null: obeys a command while `run` runs; from any thread. `command_json` is of the plugin's own form.
   * Since version 0.4.
   */
  LumistackStatus (*command)(void *instance, struct LumistackStr command_json, const struct LumistackErrorSink *error);
} LumistackOutputVtable;

/**
 * Takes bytes, in order.
 */
typedef struct LumistackByteSink {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Passed to `write`.
   */
  void *context;
  /**
   * Copies the bytes behind those of earlier calls.
   */
  LumistackStatus (*write)(void *context, struct LumistackBytes bytes, const struct LumistackErrorSink *error);
} LumistackByteSink;

/**
 * Files that an importer may read.
 */
typedef struct LumistackAssets {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Passed to `read`.
   */
  const void *context;
  /**
   * Reads a whole file; `path` is relative to the folder of the imported file, with `/` between its parts.
   */
  LumistackStatus (*read)(const void *context,
                          struct LumistackStr path,
                          const struct LumistackByteSink *bytes,
                          const struct LumistackErrorSink *error);
} LumistackAssets;

/**
 * Functions of an importer: a file of some format becomes a glTF 2.0 document.
 *
 * glTF is the form in which a scene crosses the boundary: JSON and planes of numbers, public, with a validator on the host's side.
 */
typedef struct LumistackImporterVtable {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Extensions of the files that it takes: lower case, without the dot, separated by spaces.
   */
  struct LumistackStr extensions;
  /**
   * Reads the file `file` (a name to be read through `assets`) and writes a whole `.glb` or `.gltf` to `scene`. Files that the document
   * refers to are read beside the imported file. `host` offers messages, progress and cancellation, and no files.
   */
  LumistackStatus (*import)(const struct LumistackHostServices *host,
                            struct LumistackStr params_json,
                            struct LumistackStr file,
                            const struct LumistackAssets *assets,
                            const struct LumistackByteSink *scene,
                            const struct LumistackErrorSink *error);
} LumistackImporterVtable;

/**
 * Takes a light field.
 */
typedef struct LumistackFieldSink {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Passed to every function.
   */
  void *context;
  /**
   * Pixels and views, as the geometry in `Data::description_json`; once, before the first view.
   */
  LumistackStatus (*geometry)(void *context, struct LumistackStr geometry_json, const struct LumistackErrorSink *error);
  /**
   * Copies the linear radiance `[row][col][rgb]` of one view: finite and not below 0. Every view is given exactly once, in any order.
   */
  LumistackStatus (*view_plane)(void *context,
                                size_t view_y,
                                size_t view_x,
                                const struct LumistackPlane *plane,
                                const struct LumistackErrorSink *error);
} LumistackFieldSink;

/**
 * Functions of a source, which makes a light field.
 */
typedef struct LumistackSourceVtable {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Makes the light field of one time; the display's own geometry is what is wanted, another is taken as it is. `host` as for importers.
   */
  LumistackStatus (*make)(const struct LumistackHostServices *host,
                          struct LumistackStr params_json,
                          struct LumistackStr display_json,
                          const struct LumistackTime *time,
                          const struct LumistackFieldSink *field,
                          const struct LumistackErrorSink *error);
} LumistackSourceVtable;

/**
 * Takes a layer stack of the display that the node was given. Functions may not be called from several threads at once.
 */
typedef struct LumistackStackSink {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Passed to every function.
   */
  void *context;
  /**
   * Brightness β, above 0 and at most 1: the patterns are to emit β times the target. Without this call the display's.
   */
  LumistackStatus (*brightness)(void *context, double brightness, const struct LumistackErrorSink *error);
  /**
   * Copies the values `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1. Every one is given exactly once.
   */
  LumistackStatus (*layer_plane)(void *context,
                                 size_t layer,
                                 size_t frame,
                                 const struct LumistackPlane *plane,
                                 const struct LumistackErrorSink *error);
  /**
   * Copies the emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a directional backlight, linear, 0..1. Every one is
   * given exactly once.
   */
  LumistackStatus (*emission_plane)(void *context,
                                    size_t frame,
                                    size_t bin_y,
                                    size_t bin_x,
                                    const struct LumistackPlane *plane,
                                    const struct LumistackErrorSink *error);
  /**
   * Reports how far an iterative method is: its objective after `iteration` iterations (0: at the start), which the method makes small, and the PSNR of
   * what is shown against the target, dB; NaN where it is not known. Optional, in order. Since version 0.3.
   */
  LumistackStatus (*step)(void *context,
                          uint32_t iteration,
                          double objective,
                          double psnr_view_db,
                          const struct LumistackErrorSink *error);
  /**
   * Reports how an iterative method came to the patterns: `{"solver", "start", "coarse_levels": levels of half the resolution before the first iteration,
   * "unsettled": root mean square of the change of the emission that a further exact step would make, "levels": [continuous, rounded, re-optimized] PSNR
   * in dB for panels of few bits, or null}`. Optional, once. Since version 0.3.
   */
  LumistackStatus (*solution)(void *context, struct LumistackStr solution_json, const struct LumistackErrorSink *error);
} LumistackStackSink;

/**
 * Functions of a node, which makes the layer stack of a display from a light field.
 */
typedef struct LumistackNodeVtable {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Makes the patterns of one time; `data` is a light field of the display's own geometry, with what else its description names. `host` as for importers.
   */
  LumistackStatus (*make)(const struct LumistackHostServices *host,
                          struct LumistackStr params_json,
                          struct LumistackStr display_json,
                          const struct LumistackTime *time,
                          const struct LumistackData *data,
                          const struct LumistackStackSink *stack,
                          const struct LumistackErrorSink *error);
} LumistackNodeVtable;

#endif  /* LUMISTACK_PLUGIN_H */
