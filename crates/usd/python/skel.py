"""Skinned shapes and blend shapes of UsdSkel, posed by UsdSkel's own queries."""

from pxr import Gf, Tf, Usd, UsdGeom, UsdSkel, Vt

EVERYWHERE = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)


def source(prim):
    """Returns the prim itself, or its counterpart in the prototype of an instance."""
    return prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim


class Skeletons:
    """The skeletons of all `UsdSkelRoot` prims that were added, and the shapes they pose."""

    def __init__(self, time):
        self.time = time
        self.cache = UsdSkel.Cache()
        self.skinned = {}

    def add(self, root, writer):
        """Collects the shapes that a `UsdSkelRoot` poses. After an error they keep their rest pose.
        """
        try:
            root = UsdSkel.Root(root)
            if not self.cache.Populate(root, EVERYWHERE):
                return
            for binding in self.cache.ComputeSkelBindings(root, EVERYWHERE):
                query = self.cache.GetSkelQuery(binding.GetSkeleton())
                for target in binding.GetSkinningTargets():
                    self.skinned[target.GetPrim().GetPath()] = (query, target)
        except Exception as error:
            writer.warn(root.GetPath(), "the skeletons of this SkelRoot cannot be read, so its shapes keep their rest pose: %s" % said(error))

    def key(self, prim):
        """Returns a key of a shape's pose: different poses have different keys. None without a
        pose."""
        found = self.skinned.get(prim.GetPath())
        if found is None:
            return None
        animation = found[0].GetAnimQuery()
        return (
            source(found[0].GetPrim()).GetPath(),
            source(animation.GetPrim()).GetPath() if animation else None,
        )

    def pose(self, prim, writer):
        """Returns (points, normals) of a posed mesh, in the mesh's own space; None without a pose.
        Normals are (interpolation, values), or None."""
        found = self.skinned.get(prim.GetPath())
        if found is None:
            return None
        # Python bindings differ between versions of OpenUSD. An error in them must not remove the
        # mesh.
        try:
            return self.posed(prim, writer, *found)
        except Exception as error:
            writer.warn(prim.GetPath(), "the shape cannot be posed and keeps its rest pose: %s" % said(error))
            return None

    def posed(self, prim, writer, query, target):
        mesh = UsdGeom.Mesh(prim)
        points = mesh.GetPointsAttr().Get(self.time)
        if points is None:
            return None
        points = Vt.Vec3fArray(points)
        normals = self.of_file(mesh)
        if target.HasBlendShapes():
            normals = self.blend(query, target, points, normals)
        if not target.HasJointInfluences():
            return points, normals
        if not query:
            raise ValueError("the shape's skeleton is not valid")
        joints = query.ComputeSkinningTransforms(self.time)
        if not joints:
            raise ValueError("the shape's skeleton has no transforms of joints")
        to_world = UsdGeom.XformCache(self.time)
        # The joints' transforms are in the skeleton's space, so convert them to the mesh's space.
        back = to_world.GetLocalToWorldTransform(query.GetPrim()) * to_world.GetLocalToWorldTransform(prim).GetInverse()
        joints = Vt.Matrix4dArray([joint * back for joint in joints])
        own = self.of_mesh(query, target, joints, writer)
        if target.IsRigidlyDeformed():
            matrix = target.ComputeSkinnedTransform(joints, self.time)
            # OpenUSD 26.11 returns points in double precision
            points = Vt.Vec3fArray([Gf.Vec3f(matrix.Transform(point)) for point in points])
        elif not target.ComputeSkinnedPoints(joints, points, self.time):
            raise ValueError("the shape's indices and weights of joints do not fit its points and its skeleton")
        try:
            return points, self.normals(mesh, target, own, len(points), normals)
        except Exception as error:
            writer.warn(prim.GetPath(), "the normals of the shape cannot be posed, so the normals of its polygons are used: %s" % said(error))
            return points, None

    def of_mesh(self, query, target, joints, writer):
        """Returns the transforms of the joints that a mesh lists, in the mesh's order. Joints that
        the skeleton lacks do not move, as in UsdSkel."""
        # AnimMapper.RemapTransforms does the same, but its arguments differ between versions of
        # OpenUSD.
        order = target.GetJointOrder()
        if not order:
            return joints
        place = {str(name): index for index, name in enumerate(query.GetJointOrder())}
        strangers = [str(name) for name in order if str(name) not in place]
        if strangers:
            named = ", ".join(strangers[:4]) + (" and %d more" % (len(strangers) - 4) if len(strangers) > 4 else "")
            writer.warn(target.GetPrim().GetPath(), "the shape names joints that its skeleton lacks and that do not move: %s" % named)
        return [joints[place[str(name)]] if str(name) in place else Gf.Matrix4d(1) for name in order]

    def of_file(self, mesh):
        """Returns the file's normals as (interpolation, values). None if the file has none."""
        normals, interpolation = mesh.GetNormalsAttr().Get(self.time), mesh.GetNormalsInterpolation()
        primvar = UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance("normals")
        if primvar and primvar.HasValue():
            normals, interpolation = primvar.ComputeFlattened(self.time), primvar.GetInterpolation()
        return (str(interpolation), Vt.Vec3fArray(normals)) if normals else None

    def blend(self, query, target, points, normals):
        """Adds the weighted offsets of blend shapes to points. Returns the normals with their own
        offsets."""
        animation = query.GetAnimQuery() if query else None
        weights = animation.ComputeBlendShapeWeights(self.time) if animation else None
        if weights is None:
            return normals
        mapper = target.GetBlendShapeMapper()
        if mapper:
            weights = mapper.Remap(weights)
        shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(target.GetPrim()))
        parts = shapes.ComputeSubShapeWeights(weights)
        if not parts:
            return normals
        indices = shapes.ComputeBlendShapePointIndices()
        shapes.ComputeDeformedPoints(*parts, indices, shapes.ComputeSubShapePointOffsets(), points)
        return self.blended(target, shapes, parts, indices, len(points), normals)

    def blended(self, target, shapes, parts, indices, point_count, normals):
        """Returns normals plus the weighted normal offsets of blend shapes. The offsets
        belong to points, even if the normals are face-varying."""
        offsets = [Vt.Vec3fArray() for _ in range(shapes.GetNumSubShapes())]
        for _, shape, part in zip(*parts):
            between = shapes.GetInbetween(part)
            offsets[part] = Vt.Vec3fArray((between.GetNormalOffsets() if between else shapes.GetBlendShape(shape).GetNormalOffsetsAttr().Get()) or [])
        if normals is None or not any(len(each) for each in offsets):
            return normals
        changes = Vt.Vec3fArray(point_count)
        shapes.ComputeDeformedPoints(*parts, indices, offsets, changes)
        interpolation, values = normals
        if interpolation == UsdGeom.Tokens.faceVarying:
            corners = UsdGeom.Mesh(target.GetPrim()).GetFaceVertexIndicesAttr().Get(self.time)
            changes = Vt.Vec3fArray([changes[corner] for corner in corners])
        return (interpolation, values + changes) if len(values) == len(changes) else normals

    def normals(self, mesh, target, joints, point_count, normals):
        """Returns normals, rotated with the points. None if they cannot be rotated."""
        interpolation, normals = normals or (None, None)
        if not normals or interpolation not in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.faceVarying):
            return None
        indices, weights = target.ComputeVaryingJointInfluences(point_count, self.time)
        count = len(weights) // point_count
        if interpolation == UsdGeom.Tokens.faceVarying:
            corners = mesh.GetFaceVertexIndicesAttr().Get(self.time)
            places = [corner * count + i for corner in corners for i in range(count)]
            indices, weights = ([values[place] for place in places] for values in (indices, weights))
        if len(normals) * count != len(weights):
            return None
        turns = [inverse_transpose(joint) for joint in joints]
        bind = inverse_transpose(target.GetGeomBindTransform(self.time))
        done = UsdSkel.SkinNormals(
            target.GetSkinningMethod(), bind, Vt.Matrix3dArray(turns), Vt.IntArray(indices), Vt.FloatArray(weights), count, normals
        )
        return (str(interpolation), normals) if done else None


def said(error):
    """Returns the message of an exception on one line."""
    texts = [str(error)] if not isinstance(error, Tf.ErrorException) else [getattr(part, "commentary", None) or str(part) for part in error.args]
    text = " ".join(" ".join(texts).split())
    return (text if len(text) <= 300 else text[:300] + " ...") or type(error).__name__


def inverse_transpose(matrix):
    """Returns the matrix that transforms normals if `matrix` transforms points."""
    linear = matrix.ExtractRotationMatrix()
    return linear.GetInverse().GetTranspose() if abs(linear.GetDeterminant()) > 1e-30 else Gf.Matrix3d(1)
