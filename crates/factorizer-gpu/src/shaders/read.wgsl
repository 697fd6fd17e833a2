// Functions by which rays read factors, the target and weights. They compute the same as the
// factorizer's expand.rs and rows.rs.
//
// Each buffer holds one colour channel. A factor is stored as [line][frame][column], the target as
// [field row][view][field column]. The own factor is the factor that a dispatch updates. A dispatch
// binds only the parts of the buffers that it uses (windows). Tables give the line that a ray
// reads, by [view row][field row], and the column, by [view column][field column].

struct Params {
    views_y: u32,
    views_x: u32,
    rows: u32,
    cols: u32,
    // first line (or field row) of this dispatch, and the number of lines
    first: u32,
    count: u32,
    own_cols: u32,
    // offsets of the windows, in words
    out_base: u32,
    target_base: u32,
    weights_base: u32,
    // number of workgroups in earlier dispatches of this update, and number of workgroups per line
    sums_base: u32,
    groups_x: u32,
    // offsets of the tables of the rays through each line and each column of the own factor
    own_lines: u32,
    own_columns: u32,
    // number of lines of the own factor
    stored_lines: u32,
    // offsets of the flags of valid rows and columns of rays
    counted_rows: u32,
    counted_cols: u32,
    sweeps: u32,
    brightness: f32,
    low: f32,
    high: f32,
    extrapolation: f32,
    unlit: f32,
//@ factors
    cols_{k}: u32,
    base_{k}: u32,
    y_{k}: u32,
    x_{k}: u32,
//@ end
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tables: array<u32>;
@group(0) @binding(2) var<storage, read> radiance: array<u32>;
@group(0) @binding(3) var<storage, read> roots: array<f32>;
@group(0) @binding(4) var<storage, read_write> stepped: array<f32>;
@group(0) @binding(5) var<storage, read_write> latest: array<f32>;
@group(0) @binding(6) var<storage, read_write> sums: array<vec2<f32>>;
//@ factors
@group(0) @binding({binding}) var<storage, read> values_{k}: array<f32>;
//@ end

const MISSED: u32 = 0xffffffffu;

// Two neighbouring lines or columns, as offsets into a factor's window, and the weight of the
// second.
struct Tap {
    first: u32,
    second: u32,
    t: f32,
    hit: bool,
}

fn tap(at: u32, mixed: bool, length: u32, base: u32) -> Tap {
    if (mixed) {
        let first = tables[3u * at];
        if (first == MISSED) {
            return Tap(0u, 0u, 0.0, false);
        }
        return Tap(first * length - base, tables[3u * at + 1u] * length - base, bitcast<f32>(tables[3u * at + 2u]), true);
    }
    let first = tables[at];
    if (first == MISSED) {
        return Tap(0u, 0u, 0.0, false);
    }
    return Tap(first * length - base, 0u, 0.0, true);
}

//@ factors
fn line_{k}(view_y: u32, row: u32) -> Tap {
    return tap(params.y_{k} + view_y * params.rows + row, MIXED_{k}, FRAMES * params.cols_{k}, params.base_{k});
}

fn column_{k}(view_x: u32, col: u32) -> Tap {
    return tap(params.x_{k} + view_x * params.cols + col, MIXED_{k}, 1u, 0u);
}

fn read_{k}(line: Tap, column: Tap, frame: u32) -> f32 {
    let at = frame * params.cols_{k};
    var value = values_{k}[line.first + at + column.first];
    if (MIXED_{k}) {
        let right = values_{k}[line.first + at + column.second];
        let below = values_{k}[line.second + at + column.first];
        let across = values_{k}[line.second + at + column.second];
        // mix lines first, then columns, as on the processor
        value = mix(mix(value, below, line.t), mix(right, across, line.t), column.t);
    }
    return select(OUTSIDE_{k}, value, line.hit && column.hit);
}

//@ end
// Returns βL of a ray. Half floats are unpacked from words, since native 16-bit storage was not
// faster (docs/GPU.md).
fn wanted_of(view: u32, row: u32, col: u32) -> f32 {
    let line = row * params.views_y * params.views_x + view;
    if (HALF) {
        let word = radiance[line * ((params.cols + 1u) / 2u) + col / 2u - params.target_base];
        return params.brightness * unpack2x16float(word)[col % 2u];
    }
    return params.brightness * bitcast<f32>(radiance[line * params.cols + col - params.target_base]);
}

// Returns √w of a ray.
fn root_of(view: u32, row: u32, col: u32) -> f32 {
    if (!WEIGHTED) {
        return 1.0;
    }
    return roots[(row * params.views_y * params.views_x + view) * params.cols + col - params.weights_base];
}

// Returns sin and cos of (π/2) s. The functions sin and cos of WGSL may have errors of 5e-4, so
// this function does not use them.
fn wave(s: f32) -> vec2<f32> {
    let turns = round(s);
    let x = (s - turns) * 1.57079632679490;
    let y = x * x;
    let sine = x * (1.0 + y * (-1.0 / 6.0 + y * (1.0 / 120.0 + y * (-1.0 / 5040.0 + y * (1.0 / 362880.0)))));
    let cosine = 1.0 + y * (-0.5 + y * (1.0 / 24.0 + y * (-1.0 / 720.0 + y * (1.0 / 40320.0))));
    switch (u32(i32(turns) & 3)) {
        case 0u: { return vec2<f32>(sine, cosine); }
        case 1u: { return vec2<f32>(cosine, -sine); }
        case 2u: { return vec2<f32>(-sine, -cosine); }
        default: { return vec2<f32>(-cosine, sine); }
    }
}

struct Thread {
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) index: u32,
    @builtin(workgroup_id) group: vec3<u32>,
//@ if subgroups
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(num_subgroups) subgroups: u32,
//@ end
}

// Returns the index of a workgroup's first result. A workgroup has PARTS results.
fn place_of(group: vec3<u32>) -> u32 {
    return PARTS * (params.sums_base + group.y * params.groups_x + group.x);
}

//@ if subgroups
// Writes the sum of each subgroup's results. This needs no barrier. The sums of absent subgroups
// are 0.
fn reduce(thread: Thread, found: vec2<f32>) {
    let sum = subgroupAdd(found);
    if (thread.lane == 0u) {
        for (var part = thread.subgroup; part < PARTS; part += thread.subgroups) {
            sums[place_of(thread.group) + part] = select(vec2<f32>(0.0), sum, part == thread.subgroup);
        }
    }
}
//@ end
//@ if !subgroups
var<workgroup> parts: array<vec2<f32>, 64>;

// Sums the results of a workgroup's threads.
fn reduce(thread: Thread, found: vec2<f32>) {
    parts[thread.index] = found;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half >>= 1u) {
        if (thread.index < half) {
            parts[thread.index] += parts[thread.index + half];
        }
        workgroupBarrier();
    }
    if (thread.index == 0u) {
        sums[place_of(thread.group)] = parts[0];
    }
}
//@ end
