use glam::{DVec3, Vec2, Vec3};
use lumistack_core::seed::Stream;

use super::*;

/// Tolerance for rounding of sums of f32 numbers over a few levels. Coordinates are of size 1.
const ROUNDING: f32 = 2e-6;

/// A polygon mesh that owns its lists. A [`Cage`] borrows them.
#[derive(Clone, Default)]
struct Mesh {
    points: Vec<Vec3>,
    counts: Vec<i32>,
    indices: Vec<i32>,
}

impl Mesh {
    fn new(points: Vec<Vec3>, faces: &[&[i32]]) -> Self {
        let counts = faces.iter().map(|face| face.len() as i32).collect();
        Self { points, counts, indices: faces.concat() }
    }

    /// Makes a cube with corners at ±1.
    fn cube() -> Self {
        let points =
            (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0).collect();
        Self::new(points, &[&[0, 4, 6, 2], &[1, 3, 7, 5], &[0, 1, 5, 4], &[2, 6, 7, 3], &[0, 2, 3, 1], &[4, 5, 7, 6]])
    }

    fn octahedron() -> Self {
        let points = vec![Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        let faces: [&[i32]; 8] =
            [&[0, 2, 4], &[2, 1, 4], &[1, 3, 4], &[3, 0, 4], &[2, 0, 5], &[1, 2, 5], &[3, 1, 5], &[0, 3, 5]];
        Self::new(points, &faces)
    }

    /// Returns a grid of quadrilaterals over 0..n with random heights; `torus` joins opposite
    /// sides.
    fn grid(n: i32, torus: bool, seed: u64) -> Self {
        let mut stream = Stream::new(seed);
        let side = if torus { n } else { n + 1 };
        let points =
            (0..side * side).map(|i| Vec3::new((i % side) as f32, (i / side) as f32, stream.next_f32())).collect();
        let vertex = |x: i32, y: i32| y % side * side + x % side;
        let quads: Vec<[i32; 4]> = (0..n * n)
            .map(|i| (i % n, i / n))
            .map(|(x, y)| [vertex(x, y), vertex(x + 1, y), vertex(x + 1, y + 1), vertex(x, y + 1)])
            .collect();
        Self::new(points, &quads.iter().map(|quad| quad.as_slice()).collect::<Vec<_>>())
    }

    fn cage(&self, scheme: Scheme) -> Cage<'_> {
        Cage {
            vertex_count: self.points.len(),
            face_vertex_counts: &self.counts,
            face_vertex_indices: &self.indices,
            scheme,
            ..Cage::default()
        }
    }

    fn flat(&self) -> Vec<f32> {
        self.points.iter().flat_map(|point| point.to_array()).collect()
    }
}

fn limit(cage: &Cage<'_>, level: u32, points: &[f32]) -> Vec<Vec3> {
    vectors(&Refinement::new(cage, level).vertex(points, 3))
}

/// Returns the points of a level before they are projected to the limit surface.
fn control(cage: &Cage<'_>, level: u32, points: &[f32]) -> Vec<Vec3> {
    let refinement = Refinement::new(cage, level);
    vectors(&refinement.refine_values(&refinement.levels, points, 3))
}

fn assert_near(found: Vec3, expected: Vec3, tolerance: f32) {
    assert!((found - expected).abs().max_element() <= tolerance, "{found} is not {expected}");
}

#[test]
fn a_cube_has_the_points_of_the_textbook() {
    let cube = Mesh::cube();
    let cage = cube.cage(Scheme::CatmullClark);
    let first = control(&cage, 1, &cube.flat());
    // one child for each of 8 vertices, 12 edges and 6 faces
    assert_eq!(first.len(), 26);
    for (point, child) in cube.points.iter().zip(&first) {
        assert_near(*child, *point * (5.0 / 9.0), ROUNDING);
    }
    for edge in &first[8..20] {
        let mut sizes = edge.abs().to_array();
        sizes.sort_by(f32::total_cmp);
        assert_near(sizes.into(), Vec3::new(0.0, 0.75, 0.75), ROUNDING);
    }
    for face in &first[20..] {
        assert!((face.length() - 1.0).abs() < ROUNDING);
    }
    // On the limit surface, the corners are at half of their coordinates. The centres of faces have
    // the distance 68/81 from the cube's centre. Neither value depends on the level.
    for level in 1..=4 {
        let surface = limit(&cage, level, &cube.flat());
        for (point, on_surface) in cube.points.iter().zip(&surface) {
            assert_near(*on_surface, *point * 0.5, ROUNDING);
        }
        surface[20..26].iter().for_each(|centre| assert!((centre.length() - 68.0 / 81.0).abs() < ROUNDING));
    }
}

/// Refines a mesh once with the formulas of Catmull and Clark's paper, vertex by vertex. The mesh
/// must be closed, of quadrilaterals, without creases.
fn textbook(points: &[DVec3], faces: &[[usize; 4]]) -> Vec<DVec3> {
    let centre = |face: &[usize; 4]| face.iter().map(|&i| points[i]).sum::<DVec3>() / 4.0;
    (0..points.len())
        .map(|vertex| {
            let around: Vec<_> = faces.iter().filter(|face| face.contains(&vertex)).collect();
            let n = around.len() as f64;
            let faces_mean = around.iter().map(|face| centre(face)).sum::<DVec3>() / n;
            let mut neighbours: Vec<usize> = around
                .iter()
                .flat_map(|face| {
                    let at = face.iter().position(|&i| i == vertex).unwrap();
                    [face[(at + 1) % 4], face[(at + 3) % 4]]
                })
                .collect();
            neighbours.sort_unstable();
            neighbours.dedup();
            let middles = neighbours.iter().map(|&i| (points[vertex] + points[i]) / 2.0).sum::<DVec3>() / n;
            (faces_mean + 2.0 * middles + (n - 3.0) * points[vertex]) / n
        })
        .collect()
}

#[test]
fn smooth_vertices_follow_the_textbook_at_every_level() {
    for (mut mesh, seed) in [(Mesh::cube(), 1), (Mesh::grid(5, true, 3), 2)] {
        let mut stream = Stream::new(seed);
        mesh.points.iter_mut().for_each(|p| *p += Vec3::new(stream.next_f32(), stream.next_f32(), stream.next_f32()));
        let cage = mesh.cage(Scheme::CatmullClark);
        for level in 0..3 {
            let before: Vec<DVec3> = control(&cage, level, &mesh.flat()).iter().map(|p| p.as_dvec3()).collect();
            let refinement = Refinement::new(&cage, level);
            let faces: Vec<[usize; 4]> =
                refinement.faces().map(|(_, face)| std::array::from_fn(|i| face[i] as usize)).collect();
            let expected = textbook(&before, &faces);
            let after = control(&cage, level + 1, &mesh.flat());
            for (expected, found) in expected.iter().zip(&after) {
                assert_near(*found, expected.as_vec3(), 4.0 * ROUNDING);
            }
        }
    }
}

#[test]
fn a_regular_mesh_is_a_bicubic_b_spline() {
    let mesh = Mesh::grid(6, false, 7);
    let cage = mesh.cage(Scheme::CatmullClark);
    let surface = limit(&cage, 3, &mesh.flat());
    let refinement = Refinement::new(&cage, 3);
    let normals = refinement.normals(&mesh.flat());
    let basis = |t: f64| {
        [
            (1.0 - t).powi(3),
            3.0 * t.powi(3) - 6.0 * t * t + 4.0,
            -3.0 * t.powi(3) + 3.0 * t * t + 3.0 * t + 1.0,
            t.powi(3),
        ]
        .map(|b| b / 6.0)
    };
    let slope = |t: f64| {
        [-3.0 * (1.0 - t).powi(2), 9.0 * t * t - 12.0 * t, -9.0 * t * t + 6.0 * t + 3.0, 3.0 * t * t].map(|b| b / 6.0)
    };
    // Compare only inner faces, where the surface's x and y equal the parameters of the spline.
    let mut checked = 0;
    let mut corner = 0;
    for (_, face) in refinement.faces() {
        for &vertex in face {
            let point = surface[vertex as usize];
            let normal = vectors(&normals.values)[normals.indices[corner] as usize];
            corner += 1;
            if !(1.0..5.0).contains(&point.x) || !(1.0..5.0).contains(&point.y) || checked > 4000 {
                continue;
            }
            let (x, y) = (f64::from(point.x + 1e-6).floor(), f64::from(point.y + 1e-6).floor());
            let (tx, ty) = ((f64::from(point.x) - x).max(0.0), (f64::from(point.y) - y).max(0.0));
            let sum = |wx: [f64; 4], wy: [f64; 4]| {
                let mut sum = 0.0;
                for j in 0..4 {
                    for i in 0..4 {
                        let at = (y as usize + j - 1) * 7 + x as usize + i - 1;
                        sum += wx[i] * wy[j] * f64::from(mesh.points[at].z);
                    }
                }
                sum
            };
            assert!((sum(basis(tx), basis(ty)) - f64::from(point.z)).abs() < 1e-5);
            let expected = DVec3::new(-sum(slope(tx), basis(ty)), -sum(basis(tx), slope(ty)), 1.0).normalize();
            assert_near(normal, expected.as_vec3(), 1e-4);
            checked += 1;
        }
    }
    assert!(checked > 1000);
    // The outline of the surface is the cubic B-spline curve of the boundary's points.
    let at = |i: usize| mesh.points[i].z;
    assert_near(surface[3], Vec3::new(3.0, 0.0, (at(2) + 4.0 * at(3) + at(4)) / 6.0), ROUNDING);
    assert_near(surface[0], mesh.points[0], 0.0);
}

/// The limit does not depend on the level from which it is computed. This shows that weights,
/// creases, boundaries and refinement agree. All creases here are closed or end at boundaries.
/// Where a crease ends inside, the smooth weights are only an approximation, as in OpenSubdiv.
#[test]
fn limits_are_the_same_from_every_level() {
    let (open, cube) = (Mesh::grid(4, false, 11), Mesh::cube());
    let mut bent = Mesh::octahedron();
    bent.points[4].z = 0.5;
    let cases: [(&Mesh, &[i32]); 3] =
        [(&open, &[10, 11, 12, 13, 14]), (&cube, &[0, 2, 3, 1, 0]), (&bent, &[0, 2, 1, 3, 0])];
    for scheme in [Scheme::CatmullClark, Scheme::Loop] {
        for (mesh, crease) in cases {
            for sharpness in [[0.0], [10.0]] {
                let mut cage = mesh.cage(scheme);
                let length = [crease.len() as i32];
                (cage.crease_indices, cage.crease_lengths, cage.crease_sharpnesses) = (crease, &length, &sharpness);
                let (coarse, fine) = (limit(&cage, 1, &mesh.flat()), limit(&cage, 3, &mesh.flat()));
                for (coarse, fine) in coarse.iter().zip(&fine) {
                    assert_near(*coarse, *fine, 8.0 * ROUNDING);
                }
            }
        }
    }
}

#[test]
fn normals_are_those_of_the_fine_surface() {
    let (open, cube) = (Mesh::grid(4, false, 5), Mesh::cube());
    for scheme in [Scheme::CatmullClark, Scheme::Loop] {
        for mesh in [&open, &cube, &Mesh::octahedron()] {
            let cage = mesh.cage(scheme);
            let normals = |level: u32| {
                let refinement = Refinement::new(&cage, level);
                let normals = refinement.normals(&mesh.flat());
                let mut by_vertex = vec![None; refinement.finest.vertex_count];
                let corners = refinement.faces().flat_map(|(_, face)| face.to_vec());
                corners.zip(&normals.indices).for_each(|(vertex, &normal)| {
                    by_vertex[vertex as usize] = Some(vectors(&normals.values)[normal as usize]);
                });
                by_vertex
            };
            // Vertices keep their indices over the levels. So exact normals at level 1 can be
            // compared with the small faces of level 5.
            let count = mesh.points.len();
            let fine = Refinement::new(&cage, 5);
            let surface = vectors(&fine.vertex(&mesh.flat(), 3));
            let mut sums = vec![Vec3::ZERO; count];
            for (_, face) in fine.faces() {
                for (i, &vertex) in face.iter().enumerate().filter(|(_, vertex)| (**vertex as usize) < count) {
                    let at = |k: usize| surface[face[(i + k) % face.len()] as usize] - surface[vertex as usize];
                    sums[vertex as usize] += at(1).cross(at(face.len() - 1)).normalize();
                }
            }
            for (exact, sum) in normals(1).iter().zip(sums) {
                let cosine = exact.unwrap().dot(sum.normalize());
                assert!(cosine > 0.995, "{scheme:?}: {exact:?} {sum}");
            }
        }
    }
}

#[test]
fn sharp_edges_stay_and_sharpness_falls_by_one_a_level() {
    let cube = Mesh::cube();
    let all_edges = [0, 1, 2, 3, 4, 5, 6, 7, 0, 2, 1, 3, 4, 6, 5, 7, 0, 4, 1, 5, 2, 6, 3, 7];
    let lengths = [2; 12];
    let creased = |sharpness: &[f32; 12], level: u32| {
        let mut cage = cube.cage(Scheme::CatmullClark);
        (cage.crease_indices, cage.crease_lengths, cage.crease_sharpnesses) = (&all_edges, &lengths, sharpness);
        control(&cage, level, &cube.flat())
    };
    for point in creased(&[10.0; 12], 3) {
        assert!((point.abs().max_element() - 1.0).abs() < ROUNDING, "on the cube: {point}");
    }
    // after one level, a crease of sharpness 1 is the same as an infinitely sharp crease
    assert_eq!(creased(&[1.0; 12], 1), creased(&[f32::INFINITY; 12], 1));
    assert!(creased(&[1.0; 12], 2)[0].x > -1.0 + 0.1);
    assert_eq!(creased(&[0.0; 12], 2), control(&cube.cage(Scheme::CatmullClark), 2, &cube.flat()));
    // sharpness ½ gives the midpoint of the smooth and the sharp result
    let (smooth, half, sharp) = (creased(&[0.0; 12], 1), creased(&[0.5; 12], 1), creased(&[1.0; 12], 1));
    for ((smooth, half), sharp) in smooth.iter().zip(&half).zip(&sharp) {
        assert_near(*half, smooth.midpoint(*sharp), ROUNDING);
    }
    // the list may have a sharpness per edge instead of one per crease
    let mut cage = cube.cage(Scheme::CatmullClark);
    (cage.crease_indices, cage.crease_lengths, cage.crease_sharpnesses) = (&[0, 1, 3], &[3], &[0.0, 10.0]);
    let points = control(&cage, 1, &cube.flat());
    let middle = |a: usize, b: usize| cube.points[a].midpoint(cube.points[b]);
    assert!(points[8..20].contains(&middle(1, 3)) && !points[8..20].contains(&middle(0, 1)));
    // a vertex with a sharp corner keeps its position
    let mut cage = cube.cage(Scheme::CatmullClark);
    (cage.corner_indices, cage.corner_sharpnesses) = (&[5], &[10.0]);
    let surface = limit(&cage, 2, &cube.flat());
    assert_eq!(surface[5], cube.points[5]);
    assert!(surface[4].length() < 1.0);
}

#[test]
fn creased_normals_part_at_the_crease_alone() {
    let cube = Mesh::cube();
    let mut cage = cube.cage(Scheme::CatmullClark);
    // the crease consists of the four edges around the top face
    (cage.crease_indices, cage.crease_lengths, cage.crease_sharpnesses) = (&[4, 5, 7, 6, 4], &[5], &[10.0]);
    let refinement = Refinement::new(&cage, 2);
    let surface = vectors(&refinement.vertex(&cube.flat(), 3));
    let normals = refinement.normals(&cube.flat());
    let values = vectors(&normals.values);
    let mut corner = 0;
    for (source, face) in refinement.faces() {
        for &vertex in face {
            let normal = values[normals.indices[corner] as usize];
            corner += 1;
            if source == 5 {
                assert_near(normal, Vec3::Z, 1e-5);
            } else if (surface[vertex as usize].z - 1.0).abs() < 1e-6 {
                assert!(normal.z < 0.5, "sides do not bend to the top: {normal}");
            }
        }
    }
    assert!(values.len() > refinement.finest.vertex_count);
    // a smooth surface has one normal per vertex
    let smooth = Refinement::new(&cube.cage(Scheme::CatmullClark), 2);
    assert_eq!(smooth.normals(&cube.flat()).values.len(), 3 * smooth.finest.vertex_count);
}

#[test]
fn topology_is_kept() {
    let pentagon = Mesh::new(vec![Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y, Vec3::Z], &[&[0, 1, 2, 3, 4]]);
    for (mesh, characteristic) in
        [(Mesh::cube(), 2), (Mesh::grid(3, true, 1), 0), (pentagon, 1), (Mesh::octahedron(), 2)]
    {
        for scheme in [Scheme::CatmullClark, Scheme::Loop, Scheme::Bilinear] {
            for level in 0..4 {
                let finest = Refinement::new(&mesh.cage(scheme), level).finest;
                let euler = finest.vertex_count as i64 - finest.edges.len() as i64 + finest.face_count() as i64;
                assert_eq!(euler, characteristic, "{scheme:?} level {level}");
                let four = 4usize.pow(level.saturating_sub(1));
                let corners: usize = mesh.counts.iter().map(|&count| count as usize).sum();
                match scheme {
                    Scheme::Loop => {}
                    _ if level == 0 => assert_eq!(finest.face_count(), mesh.counts.len()),
                    _ => assert_eq!(finest.face_count(), corners * four),
                }
            }
        }
    }
}

#[test]
fn planes_stay_planes_and_weights_sum_to_one() {
    let mut mesh = Mesh::grid(4, false, 9);
    mesh.points.iter_mut().for_each(|point| point.z = 0.25 * point.x - 0.5 * point.y + 3.0);
    for scheme in [Scheme::CatmullClark, Scheme::Loop, Scheme::Bilinear] {
        let refinement = Refinement::new(&mesh.cage(scheme), 3);
        for point in vectors(&refinement.vertex(&mesh.flat(), 3)) {
            assert!((0.25 * point.x - 0.5 * point.y + 3.0 - point.z).abs() < 1e-5);
        }
        let normal = Vec3::new(-0.25, 0.5, 1.0).normalize();
        vectors(&refinement.normals(&mesh.flat()).values).iter().for_each(|&found| assert_near(found, normal, 1e-5));
        let ones = vec![1.0; mesh.points.len()];
        refinement
            .vertex(&ones, 1)
            .iter()
            .chain(&refinement.varying(&ones, 1))
            .for_each(|sum| assert!((sum - 1.0).abs() < 1e-6));
    }
}

#[test]
fn bilinear_surfaces_are_only_cut() {
    let cube = Mesh::cube();
    let refinement = Refinement::new(&cube.cage(Scheme::Bilinear), 2);
    for point in vectors(&refinement.vertex(&cube.flat(), 3)) {
        assert_eq!(point.abs().max_element(), 1.0);
    }
    let normals = refinement.normals(&cube.flat());
    let flat = vectors(&normals.values);
    assert!(flat.iter().all(|normal| normal.abs().max_element() > 0.999_99));
    // a smooth surface has the same varying data as the bilinear surface
    let smooth = Refinement::new(&cube.cage(Scheme::CatmullClark), 2);
    assert_eq!(smooth.varying(&cube.flat(), 3), refinement.vertex(&cube.flat(), 3));
}

#[test]
fn boundaries_follow_their_rule_and_holes_are_left_out() {
    let mesh = Mesh::grid(4, false, 2);
    let with = |boundary: Boundary| Cage { boundary, ..mesh.cage(Scheme::CatmullClark) };
    let corner = |boundary: Boundary| limit(&with(boundary), 2, &mesh.flat())[0];
    assert_eq!(corner(Boundary::EdgeAndCorner), mesh.points[0]);
    assert!(corner(Boundary::EdgeOnly).x > 0.1);
    let sources = |cage: &Cage<'_>| {
        let mut sources: Vec<u32> = Refinement::new(cage, 1).faces().map(|(source, _)| source).collect();
        sources.dedup();
        sources
    };
    assert_eq!(sources(&with(Boundary::None)), [5, 6, 9, 10]);
    let holes = Cage { hole_indices: &[0, 3, 77, -1], ..with(Boundary::EdgeOnly) };
    assert_eq!(sources(&holes).len(), 14);
    // a hole still affects the shape of its neighbours
    assert_eq!(limit(&holes, 2, &mesh.flat()), limit(&with(Boundary::EdgeOnly), 2, &mesh.flat()));
}

/// Returns three quadrilaterals in a 3 × 1 strip with a seam between the second and the third.
fn strip() -> (Mesh, Vec<f32>, Vec<u32>) {
    let points = (0..8).map(|i| Vec3::new((i % 4) as f32, (i / 4) as f32, 0.0)).collect();
    let mesh = Mesh::new(points, &[&[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6]]);
    let uvs: Vec<Vec2> = [
        [0.0, 0.0],
        [1.0, 0.0],
        [2.0, 0.0],
        [0.0, 1.0],
        [1.0, 1.0],
        [2.0, 1.0],
        [5.0, 5.0],
        [6.0, 5.0],
        [5.0, 6.0],
        [6.0, 6.0],
    ]
    .map(Vec2::from)
    .to_vec();
    let values = uvs.iter().flat_map(|uv| uv.to_array()).collect();
    (mesh, values, vec![0, 1, 4, 3, 1, 2, 5, 4, 6, 7, 9, 8])
}

#[test]
fn face_varying_data_keep_their_seams() {
    let (mesh, values, indices) = strip();
    let refinement = Refinement::new(&mesh.cage(Scheme::CatmullClark), 3);
    let at = |data: &Indexed| -> Vec<Vec2> {
        data.indices.iter().map(|&i| Vec2::new(data.values[2 * i as usize], data.values[2 * i as usize + 1])).collect()
    };
    let corner_sources: Vec<u32> = refinement.faces().flat_map(|(source, face)| vec![source; face.len()]).collect();
    for rule in [
        FaceVarying::None,
        FaceVarying::CornersOnly,
        FaceVarying::CornersPlus1,
        FaceVarying::CornersPlus2,
        FaceVarying::Boundaries,
        FaceVarying::All,
    ] {
        let uvs = at(&refinement.face_varying(rule, &values, &indices, 2).unwrap());
        assert_eq!(uvs.len(), corner_sources.len());
        for (&source, uv) in corner_sources.iter().zip(&uvs) {
            let inside = if source == 2 { uv.min_element() >= 5.0 } else { uv.max_element() <= 2.0 };
            assert!(inside, "{rule:?}: {uv} in face {source}");
        }
        let reaches_corner = uvs.contains(&Vec2::new(6.0, 6.0));
        assert_eq!(reaches_corner, rule != FaceVarying::None, "{rule:?}");
    }
    // equal values with different indices are joined, so the result is the same
    let separate: Vec<f32> = indices.iter().flat_map(|&i| values[2 * i as usize..][..2].to_vec()).collect();
    let numbers: Vec<u32> = (0..indices.len() as u32).collect();
    let joined = refinement.face_varying(FaceVarying::CornersPlus1, &separate, &numbers, 2).unwrap();
    assert_eq!(at(&joined), at(&refinement.face_varying(FaceVarying::CornersPlus1, &values, &indices, 2).unwrap()));
    assert!(refinement.face_varying(FaceVarying::All, &values, &indices[1..], 2).is_none());
    assert!(refinement.face_varying(FaceVarying::All, &values[..4], &indices, 2).is_none());
}

#[test]
fn face_varying_data_without_seams_are_vertex_data() {
    for mesh in [Mesh::cube(), Mesh::grid(3, false, 4)] {
        for scheme in [Scheme::CatmullClark, Scheme::Loop] {
            let mut cage = mesh.cage(scheme);
            (cage.crease_indices, cage.crease_lengths, cage.crease_sharpnesses) = (&[1, 0, 2], &[3], &[1.5]);
            let refinement = Refinement::new(&cage, 2);
            let indices: Vec<u32> = mesh.indices.iter().map(|&i| i as u32).collect();
            let found = refinement.face_varying(FaceVarying::CornersPlus1, &mesh.flat(), &indices, 3).unwrap();
            let by_vertex = vectors(&refinement.vertex(&mesh.flat(), 3));
            let expected: Vec<Vec3> = refinement
                .faces()
                .flat_map(|(_, face)| face.to_vec())
                .map(|vertex| by_vertex[vertex as usize])
                .collect();
            let found: Vec<Vec3> = found.indices.iter().map(|&i| vectors(&found.values)[i as usize]).collect();
            for (found, expected) in found.iter().zip(&expected) {
                assert_near(*found, *expected, 4.0 * ROUNDING);
            }
        }
    }
}

/// Refines random polygons over few vertices. Vertices repeat, edges have many faces, the
/// orientation is inconsistent, and some indices are invalid.
#[test]
fn broken_meshes_do_not_panic_and_stay_in_their_hull() {
    let mut stream = Stream::new(17);
    let mut number = |count: i32| (stream.next_f32() * count as f32) as i32;
    for round in 0..300 {
        let vertex_count = 1 + number(9);
        let points: Vec<Vec3> =
            (0..vertex_count).map(|_| Vec3::new(number(5) as f32, number(5) as f32, number(5) as f32)).collect();
        let counts: Vec<i32> = (0..number(8)).map(|_| number(7) - 1).collect();
        let total: i32 = counts.iter().map(|count| (*count).max(0)).sum();
        let junk = round % 5 == 0;
        let indices: Vec<i32> = (0..total + if junk { number(9) - 4 } else { 0 })
            .map(|_| number(vertex_count + i32::from(junk)) - i32::from(junk))
            .collect();
        let mesh = Mesh { points, counts, indices };
        let numbers: Vec<i32> = (0..6).map(|_| number(12) - 1).collect();
        for scheme in [Scheme::CatmullClark, Scheme::Loop, Scheme::Bilinear] {
            let mut cage = mesh.cage(scheme);
            (cage.crease_indices, cage.crease_lengths, cage.crease_sharpnesses) =
                (&numbers, &[2, 3, -1, 9], &[1.0, f32::NAN, 20.0, -3.0]);
            (cage.corner_indices, cage.corner_sharpnesses) = (&numbers, &[0.5, f32::NAN]);
            cage.boundary = [Boundary::None, Boundary::EdgeOnly, Boundary::EdgeAndCorner][round % 3];
            let refinement = Refinement::new(&cage, 2);
            let flat = mesh.flat();
            for point in vectors(&refinement.vertex(&flat, 3)) {
                assert!(point.is_finite() && point.abs().max_element() < 20.0, "{point}");
            }
            let normals = refinement.normals(&flat);
            vectors(&normals.values).iter().for_each(|normal| assert!((normal.length() - 1.0).abs() < 1e-4));
            if let Some(data) =
                refinement.face_varying(FaceVarying::CornersPlus2, &[1.0; 4], &vec![3; mesh.indices.len()], 1)
            {
                assert_eq!(data.indices.len(), normals.indices.len());
                data.values.iter().for_each(|value| assert!((value - 1.0).abs() < 1e-5));
            }
        }
    }
}

#[test]
fn levels_stop_at_the_budget() {
    // 1000 quadrilaterals give 8000 triangles at level 1, and 32000 at level 2
    assert_eq!(affordable_level(4000, 2, 32_000), 2);
    assert_eq!(affordable_level(4000, 2, 31_999), 1);
    assert_eq!(affordable_level(4000, 2, 7_999), 0);
    assert_eq!(affordable_level(usize::MAX, 9, 200_000), 0);
    assert_eq!(affordable_level(0, 3, 0), 3);
    // The first three meshes have 24 corners (a cube), 63 corners (one more than level 4 allows),
    // and 4000 corners (1000 quadrilaterals). The last three meshes are dense.
    assert_eq!([24, 63, 4000, 25_000, 30_000, 200_000].map(level_for), [4, 3, 2, 2, 1, 0]);
}
