// Kernels that measure a device's limits: copies, and multiply-adds.

@group(0) @binding(0) var<storage, read> from_values: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> to_values: array<vec4<f32>>;

@compute @workgroup_size(64)
fn copy(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = id.y * groups.x * 64u + id.x;
    to_values[at] = from_values[at];
}

// Each thread computes 8 chains of 4 lanes with 64 steps, which are 2048 multiply-adds.
@compute @workgroup_size(64)
fn multiply_add(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = id.y * groups.x * 64u + id.x;
    let factor = from_values[at];
    var a = factor;
    var b = factor + 0.1;
    var c = factor + 0.2;
    var d = factor + 0.3;
    var e = factor + 0.4;
    var f = factor + 0.5;
    var g = factor + 0.6;
    var h = factor + 0.7;
    for (var step = 0u; step < 64u; step++) {
        a = fma(a, factor, b);
        b = fma(b, factor, c);
        c = fma(c, factor, d);
        d = fma(d, factor, e);
        e = fma(e, factor, f);
        f = fma(f, factor, g);
        g = fma(g, factor, h);
        h = fma(h, factor, a);
    }
    to_values[at] = a + b + c + d + e + f + g + h;
}
