/* Plugins of Lumistack, for C. Generated from the Rust types of lumistack-plugin-abi; do not edit.
 *
 * A shared library lumistack_plugin_NAME (with the system's prefix and suffix) exports for every plugin ID
 *
 *     const LumistackDescriptor *lumistack_plugin_entry_ID(void);
 *
 * A struct that may grow starts with its own size in bytes (a descriptor: with its version, then its size), and
 * grows only at its end. Set `size` of your structs to their `sizeof`, and read at most `size` bytes of the other
 * side's structs. Texts are UTF-8 with a length, never null-terminated.
 * Nothing may unwind into the caller. docs/PLUGINS.md shows a whole plugin.
 */

#ifndef LUMISTACK_PLUGIN_H
#define LUMISTACK_PLUGIN_H

#include <stddef.h>
#include <stdint.h>

/**
 * Major version of the interface, which must be the same in the program and in the plugin. The
 * section *Versions* of this crate's documentation lists the promises of versions 1.x.
 */
#define LUMISTACK_ABI_MAJOR 1

/**
 * Minor version of the interface. Additions raise it: members at the ends of structs, constants,
 * and keys of JSON.
 */
#define LUMISTACK_ABI_MINOR 0

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
 * Writes or presents light fields and patterns; see `OutputVtable`.
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
 * A file, which an importer reads.
 */
#define LUMISTACK_PORT_FILE (1 << 3)

/**
 * An operation failed, and the plugin continues without its result.
 */
#define LUMISTACK_LEVEL_ERROR 1

/**
 * A problem that the user should know.
 */
#define LUMISTACK_LEVEL_WARN 2

/**
 * Information for the user.
 */
#define LUMISTACK_LEVEL_INFO 3

/**
 * Information for the plugin's developer.
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
 * Description of a plugin. All texts live as long as the process.
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
   * One of `kind`; it selects the type of `vtable`.
   */
  uint32_t kind;
  /**
   * Accepted input ports, bits of `port`: `FILE` for importers, none for
   * sources, `LIGHT_FIELD` for nodes. An output accepts
   * `LIGHT_FIELD`, `LAYER_STACK` or both.
   */
  uint32_t ports;
  /**
   * Name in job files and on the command line: lower-case letters, digits and underscores. The
   * first character is a letter.
   */
  struct LumistackStr id;
  /**
   * Version of the plugin, `major.minor.patch`.
   */
  struct LumistackStr version;
  /**
   * Description for users; lists show its first sentence.
   */
  struct LumistackStr doc;
  /**
   * Parameters: `{"params": [{"name", "kind", "default", "min", "max", "options", "unit",
   * "help"}, ...]}`.
   */
  struct LumistackStr schema_json;
  /**
   * Functions of the plugin's kind; see `kind`.
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
 * The call failed; the error text states why.
 */
#define LUMISTACK_STATUS_FAILED 1
/**
 * The call stopped because the host cancelled. This does not state whether the input is valid.
 */
#define LUMISTACK_STATUS_CANCELLED 2
/**
 * The callee does not support the parameters or data; the error text names them.
 */
#define LUMISTACK_STATUS_REFUSED 3
/**
 * The callee panicked; the error text is the panic's message.
 */
#define LUMISTACK_STATUS_PANICKED 4

/**
 * Receives the error text of one call. The caller provides the sink, so no memory changes its
 * owner, and calls from several threads do not mix their texts.
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
   * Copies `text`, which replaces an earlier text.
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
 * A lent array of 1 to 4 axes, the outermost axis first.
 */
typedef struct LumistackPlane {
  /**
   * Size of this struct in bytes. The caller that requests a plane sets it.
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
   * Length of every axis; 1 for the axes past `ndim`.
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
   * Releases the plane. If null, the plane needs no release: it stays valid until the `submit`
   * or `make` that fetched it returns.
   */
  void (*release)(void *owner);
} LumistackPlane;

/**
 * Data of a time step, lent until `submit` or `make` returns. A function returns
 * `Status::REFUSED` if the data do not contain its plane. Several threads may call the functions
 * in parallel.
 */
typedef struct LumistackData {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * One bit of `port`: the kind of the data.
   */
  uint32_t port;
  /**
   * Passed to every function.
   */
  const void *context;
  /**
   * Shapes and geometry as JSON.
   *
   * * A layer stack: `{"port": "layer_stack", "brightness", "frames", "layers": [[rows, cols],
   *   ...], "emission", "target": geometry, "target_views", "target_depth": depth}`. `layers`
   *   begins with the rearmost layer. `emission` is null or `[bins_y, bins_x, lenslet_rows,
   *   lenslet_cols]`. `target_views` is true if `view_plane` lends the target's views.
   * * A light field: `{"port": "light_field", "geometry": geometry, "depth": depth}`.
   * * A node's light field also has `"seed"`, `"weights"` and `"start"`. `weights` is
   *   `{"per_view": [[...], ...]}` or `"per_ray"` (see `weight_plane`); without it all rays have
   *   the same weight. `start` is `{"brightness"}` if there is a warm start. The warm start's
   *   patterns have the display's shape; `layer_plane` and `emission_plane` lend them.
   * * A depth: `{"rows", "cols", "z_mm": [...]}`, row by row, in millimetres towards the viewer,
   *   null for a miss. It belongs to the view [view rows / 2, view columns / 2], and may be
   *   coarser than the views. If the depth is unknown, the keys `depth` and `target_depth` are
   *   left out.
   * * A geometry: `{"rows", "cols", "pitch_mm", "projection": "oblique" | "perspective",
   *   "distance_mm", "slope_x": [...], "slope_y": [...]}`.
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
   * Emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a directional
   * backlight, linear, 0..1.
   */
  LumistackStatus (*emission_plane)(const void *context,
                                    size_t frame,
                                    size_t bin_y,
                                    size_t bin_x,
                                    struct LumistackPlane *plane,
                                    const struct LumistackErrorSink *error);
  /**
   * Linear radiance `[row][col][rgb]` of one view: of a light field, or of a layer stack's
   * target if `target_views` is true.
   */
  LumistackStatus (*view_plane)(const void *context,
                                size_t view_y,
                                size_t view_x,
                                struct LumistackPlane *plane,
                                const struct LumistackErrorSink *error);
  /**
   * Weights `[row][col][1]`, at least 0, of the rays of one view, if `weights` of the
   * description is `"per_ray"`.
   */
  LumistackStatus (*weight_plane)(const void *context,
                                  size_t view_y,
                                  size_t view_x,
                                  struct LumistackPlane *plane,
                                  const struct LumistackErrorSink *error);
} LumistackData;

/**
 * Direction or eye position from which the display is seen.
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
   * Direction or eye position; its meaning depends on `kind`.
   */
  double value[3];
} LumistackView;

/**
 * Functions of the host, which any thread may call. An output may call them from `open` until
 * `close` returns; other plugins may call them until `import` or `make` returns.
 *
 * The functions are passed as a table because every library has its own statics (loggers,
 * allocators, thread pools), and cannot reach those of the host.
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
   * Starts a stage of `total` steps; `unit` names them, such as "files".
   */
  void (*progress_begin)(const void *context, struct LumistackStr stage, uint64_t total, struct LumistackStr unit);
  /**
   * Reports finished steps. `note` is a short value to show next to the progress bar, or empty.
   */
  void (*progress_advance)(const void *context, uint64_t steps, struct LumistackStr note);
  /**
   * Ends the stage.
   */
  void (*progress_end)(const void *context);
  /**
   * Returns nonzero once the user cancelled. A plugin calls this function often during long
   * work. After a nonzero result the plugin returns `Status::CANCELLED`.
   */
  uint8_t (*is_cancelled)(const void *context);
  /**
   * Creates a file, and stores its handle in `*file`. `path` is relative to the output's folder,
   * with `/` between names and no `..`.
   */
  LumistackStatus (*file_open)(const void *context,
                               struct LumistackStr path,
                               uint64_t *file,
                               const struct LumistackErrorSink *error);
  /**
   * Appends bytes to an open file.
   */
  LumistackStatus (*file_append)(const void *context,
                                 uint64_t file,
                                 struct LumistackBytes bytes,
                                 const struct LumistackErrorSink *error);
  /**
   * Completes the file and closes the handle. The file appears in the output's folder once the
   * output has finished.
   */
  LumistackStatus (*file_commit)(const void *context, uint64_t file, const struct LumistackErrorSink *error);
  /**
   * Drops the file and closes the handle. Nothing of the file remains.
   */
  LumistackStatus (*file_abort)(const void *context, uint64_t file, const struct LumistackErrorSink *error);
  /**
   * Computes the seen picture of a submitted layer stack from one viewpoint.
   *
   * The result is emitted linear radiance `[row][col][rgb]`, not divided by the stack's
   * brightness. Each value is the mean over the area of a pixel of the target. `data` is the
   * argument of `submit`. The plugin releases the plane.
   */
  LumistackStatus (*simulate)(const void *context,
                              const struct LumistackData *data,
                              const struct LumistackView *view,
                              struct LumistackPlane *plane,
                              const struct LumistackErrorSink *error);
  /**
   * Sends an event of a presenter to the program that runs the presentation. The plugin defines
   * the form of the JSON.
   */
  void (*tell)(const void *context, struct LumistackStr event_json);
  /**
   * Port whose data the output will receive, a bit of `port`; 0 if the host does
   * not know the port.
   */
  uint32_t port;
} LumistackHostServices;

/**
 * Position of a time step in a sequence.
 */
typedef struct LumistackTime {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Number of the time step. For outputs and nodes the first number is 0; a still has the number
   * 0. For a source the job sets the first number.
   */
  uint64_t index;
  /**
   * Time in the scene, seconds.
   */
  double seconds;
} LumistackTime;

/**
 * Functions of an output plugin. All but `run` and `command` are required.
 *
 * `error` receives the text of a status other than `Status::OK`; it may be null if the caller
 * does not need the text.
 */
typedef struct LumistackOutputVtable {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Starts an output. `params_json` is an object with any of the schema's parameters.
   * `display_json` is the display file as JSON. `host` is valid until `close` returns.
   *
   * On success `*instance` is a handle for the other functions. After a failure `*instance` is
   * unchanged, and `close` is not called.
   */
  LumistackStatus (*open)(const struct LumistackHostServices *host,
                          struct LumistackStr params_json,
                          struct LumistackStr display_json,
                          void **instance,
                          const struct LumistackErrorSink *error);
  /**
   * Takes one time step of the sequence. Any thread may call this function; several threads may
   * call it in parallel.
   */
  LumistackStatus (*submit)(void *instance,
                            const struct LumistackTime *time,
                            const struct LumistackData *data,
                            const struct LumistackErrorSink *error);
  /**
   * For presenters only, else null. Runs on the main thread until the user closes the
   * presentation or the host cancels. Meanwhile every `submit` replaces the presented patterns.
   */
  LumistackStatus (*run)(void *instance, const struct LumistackErrorSink *error);
  /**
   * Completes the output: no more data follow. Called at most once, after every `submit` has
   * returned.
   */
  LumistackStatus (*finish)(void *instance, const struct LumistackErrorSink *error);
  /**
   * Frees the handle. Called exactly once, as the last function, in any state. Without an
   * earlier `finish` the output is discarded.
   */
  void (*close)(void *instance);
  /**
   * For presenters with commands, else null. Executes a command while `run` runs. Any thread may
   * call this function. The plugin defines the form of `command_json`.
   */
  LumistackStatus (*command)(void *instance, struct LumistackStr command_json, const struct LumistackErrorSink *error);
} LumistackOutputVtable;

/**
 * Receives a sequence of bytes, piece by piece.
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
   * Appends a copy of the bytes.
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
   * Reads a whole file. `path` is relative to the folder of the imported file, with `/` between
   * names.
   */
  LumistackStatus (*read)(const void *context,
                          struct LumistackStr path,
                          const struct LumistackByteSink *bytes,
                          const struct LumistackErrorSink *error);
} LumistackAssets;

/**
 * Functions of an importer, which converts a file to a glTF 2.0 document.
 *
 * A scene crosses the interface as glTF: a public format of JSON and arrays, which the host
 * validates.
 */
typedef struct LumistackImporterVtable {
  /**
   * Size of this struct in bytes.
   */
  size_t size;
  /**
   * Extensions of the files that the importer reads: lower case, without the dot, separated by
   * spaces.
   */
  struct LumistackStr extensions;
  /**
   * Reads the file `file`, a path for `read` of `assets`, and writes a whole `.glb` or `.gltf`
   * to `scene`. The document may refer to files in the imported file's folder. `host` offers
   * messages, progress and cancellation, but no files.
   */
  LumistackStatus (*import)(const struct LumistackHostServices *host,
                            struct LumistackStr params_json,
                            struct LumistackStr file,
                            const struct LumistackAssets *assets,
                            const struct LumistackByteSink *scene,
                            const struct LumistackErrorSink *error);
} LumistackImporterVtable;

/**
 * Receives a light field.
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
   * Sets the light field's geometry, in the form of a geometry in `Data::description_json`.
   * Called once, before the first view.
   */
  LumistackStatus (*geometry)(void *context, struct LumistackStr geometry_json, const struct LumistackErrorSink *error);
  /**
   * Copies the linear radiance `[row][col][rgb]` of one view, finite and at least 0. Called
   * exactly once for every view, in any order.
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
   * Makes the light field of one time step. It should have the display's geometry; the host
   * accepts other geometries. `host` offers messages, progress and cancellation, but no files.
   */
  LumistackStatus (*make)(const struct LumistackHostServices *host,
                          struct LumistackStr params_json,
                          struct LumistackStr display_json,
                          const struct LumistackTime *time,
                          const struct LumistackFieldSink *field,
                          const struct LumistackErrorSink *error);
} LumistackSourceVtable;

/**
 * Receives a layer stack for the node's display. Two threads must never call these functions at
 * the same time.
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
   * Sets the brightness β, above 0 and at most 1: the patterns emit β times the target. Without
   * this call β is the brightness in the display file.
   */
  LumistackStatus (*brightness)(void *context, double brightness, const struct LumistackErrorSink *error);
  /**
   * Copies the values `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1.
   * Called exactly once for each layer and frame.
   */
  LumistackStatus (*layer_plane)(void *context,
                                 size_t layer,
                                 size_t frame,
                                 const struct LumistackPlane *plane,
                                 const struct LumistackErrorSink *error);
  /**
   * Copies the emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a
   * directional backlight, linear, 0..1. Called exactly once for each bin and frame.
   */
  LumistackStatus (*emission_plane)(void *context,
                                    size_t frame,
                                    size_t bin_y,
                                    size_t bin_x,
                                    const struct LumistackPlane *plane,
                                    const struct LumistackErrorSink *error);
  /**
   * Reports the progress of an iterative method; nodes may omit this call. `objective` is the
   * value that the method minimizes, after `iteration` iterations. Iteration 0 is the start, and
   * `iteration` must increase from call to call. `psnr_view_db` is the PSNR of the emitted light
   * field against the target, dB; NaN if it is unknown.
   */
  LumistackStatus (*step)(void *context,
                          uint32_t iteration,
                          double objective,
                          double psnr_view_db,
                          const struct LumistackErrorSink *error);
  /**
   * Reports the result of an iterative method: `{"solver", "start", "coarse_levels",
   * "kkt_residual", "levels"}`. Nodes may omit this call, and make it at most once.
   *
   * * `coarse_levels`: number of coarser resolutions, each half the next finer one, that were
   *   solved first.
   * * `kkt_residual`: an exact update of a single value of the patterns would change the emitted
   *   light field. The residual is the root mean square of these changes, over all values that
   *   may change.
   * * `levels`: PSNR in dB of [continuous, rounded, re-optimized] patterns for panels of few
   *   bits, or null.
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
   * Makes the patterns of one time step. `data` is a light field of the display's geometry; its
   * description has the further keys for nodes that `Data::description_json` lists. `host`
   * offers messages, progress and cancellation, but no files.
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
