# pyright: basic
"""What the guarded process (`keypose.io.guarded_child`) does to read FBX with ufbx; keypose itself never imports it.

ufbx's binding releases objects more often than it holds them. Nothing that it returns is therefore ever let go, the
garbage collector is off, and the process ends without tearing anything down.
"""

import gc
import math
from array import array
from itertools import chain

MOST_FRAMES = 1_000_000
MOST_SAMPLES = 50_000_000
DEPTH_LIMIT = 512
DROPPED = ("constraints", "line_curves", "nurbs_curves", "nurbs_surfaces", "lod_groups")

_held = []


def hold(value):
    """``value``, which then lives as long as the process."""
    _held.append(value)
    return value


def get(value, path):
    """An attribute of an attribute ..., each of them held."""
    for name in path.split("."):
        value = hold(getattr(value, name))
    return value


def items(elements):
    """All elements of one of ufbx's lists."""
    return [hold(elements[i]) for i in range(len(elements))]


def buffer(record, elements, width):
    """One of ufbx's lists of vectors, which are buffers of doubles."""
    return record.put("d", hold(memoryview(elements)) if len(elements) else b"", width)


def indices(record, elements):
    """One of ufbx's lists of integers."""
    return record.put("I", array("I", elements).tobytes())


def transform(value):
    """Translation, rotation as xyzw, scale."""
    return (*value.translation, *value.rotation, *value.scale)


def matrix(value):
    """Four columns of three."""
    return (*value.c0, *value.c1, *value.c2, *value.c3)


def identity_of(element):
    """The number of an element among its kind; -1 for none."""
    return -1 if element is None else element.typed_id


def vertex_values(record, attribute, width):
    """Values and, for each corner, which of them is used; none where there are none."""
    if not attribute.exists:
        return None
    return {
        "values": buffer(record, hold(attribute.values), width),
        "indices": indices(record, hold(attribute.indices)),
    }


def read_nodes(record, nodes, evaluate):
    """All nodes but the root that ufbx puts above them, and their transforms at rest."""
    facts = []
    for node in nodes:
        if node.is_root:
            facts.append({"root": True})
            continue
        props = hold(node.props)
        role = hold(props.find_prop("keypose_role"))
        end = hold(props.find_prop("keypose_end_site"))
        facts.append(
            {
                "name": node.name,
                "parent": identity_of(hold(node.parent)),
                "kind": int(node.attrib_type),
                "mesh": identity_of(hold(node.mesh)),
                "helper": bool(node.is_geometry_transform_helper or node.is_scale_helper),
                "carrier": bool(props.find_bool("keypose_carrier", False)),
                "role": role.value_str if role is not None else "",
                "end_site": list(end.value_vec4)[:3] if end is not None else None,
                "materials": [m.typed_id for m in items(hold(node.materials))],
                "geometry": list(matrix(node.geometry_to_node)) if node.has_geometry_transform else None,
                "order": 0 if IgnoredOrder.holds(node) else int(node.rotation_order),
            }
        )
    rest = record.reals(chain.from_iterable(transform(evaluate.rest(n)) for n in nodes), 10)
    return facts, rest


def read_meshes(record, scene):
    """Polygons as they are; the corners' attributes."""
    facts = []
    for mesh in items(hold(scene.meshes)):
        layers = items(hold(mesh.uv_sets))
        colors = hold(mesh.vertex_color)
        parts = hold(hold(mesh.props).find_prop("keypose_parts"))
        facts.append(
            {
                "name": mesh.name,
                "parts": parts.value_str if parts is not None else "",
                "positions": buffer(record, hold(mesh.vertices), 3),
                "corners": indices(record, hold(mesh.vertex_indices)),
                "faces": indices(record, chain.from_iterable(hold(mesh.faces))),
                "face_materials": indices(record, hold(mesh.face_material)),
                "normals": vertex_values(record, hold(mesh.vertex_normal), 3),
                "generated_normals": bool(mesh.generated_normals),
                "uvs": [vertex_values(record, hold(layer.vertex_uv), 2) for layer in layers],
                "colors": vertex_values(record, colors, 4),
                "materials": [m.typed_id for m in items(hold(mesh.materials))],
                "skins": [d.typed_id for d in items(hold(mesh.skin_deformers))],
                "morphs": [d.typed_id for d in items(hold(mesh.blend_deformers))],
                "caches": len(hold(mesh.cache_deformers)),
                "subdivision": int(mesh.subdivision_display_mode),
            }
        )
    return facts


def read_skins(record, scene):
    """Clusters: a bone, its matrix, and its vertices with their weights."""
    facts = []
    for skin in items(hold(scene.skin_deformers)):
        clusters = [
            {
                "bone": identity_of(hold(cluster.bone_node)),
                "matrix": list(matrix(cluster.geometry_to_bone)),
                "vertices": indices(record, hold(cluster.vertices)),
                "weights": buffer(record, hold(cluster.weights), 0),
            }
            for cluster in items(hold(skin.clusters))
        ]
        facts.append(
            {
                "name": skin.name,
                "method": int(skin.skinning_method),
                "clusters": clusters,
                "dq_vertices": indices(record, hold(skin.dq_vertices)),
                "dq_weights": buffer(record, hold(skin.dq_weights), 0),
            }
        )
    return facts


def read_morphs(record, scene):
    """Blend deformers, their channels, and the shapes that these reach at certain weights."""
    deformers = [
        {"name": d.name, "channels": [c.typed_id for c in items(hold(d.channels))]}
        for d in items(hold(scene.blend_deformers))
    ]
    channels = []
    for channel in items(hold(scene.blend_channels)):
        keys = items(hold(channel.keyframes))
        channels.append(
            {
                "name": channel.name,
                "place": hold(channel.props).find_int("keypose_place", -1),
                "weight": channel.weight,
                "keys": [[k.target_weight, hold(k.shape).typed_id] for k in keys],
            }
        )
    shapes = [
        {
            "name": shape.name,
            "vertices": indices(record, hold(shape.offset_vertices)),
            "positions": buffer(record, hold(shape.position_offsets), 3),
            "normals": buffer(record, hold(shape.normal_offsets), 3),
        }
        for shape in items(hold(scene.blend_shapes))
    ]
    return deformers, channels, shapes


def read_materials(record, scene):
    """Names, colours and the picture of the base colour."""
    facts = []
    for material in items(hold(scene.materials)):
        pbr = hold(material.pbr)
        base = hold(pbr.base_color)
        texture = hold(base.texture)
        picture = None
        if texture is not None:
            content = texture.content
            picture = {"name": texture.relative_filename or texture.filename or texture.name}
            picture["data"] = record.put("B", content) if content else None
        facts.append(
            {
                "name": material.name,
                "base_color": list(base.value_vec4) if base.has_value else None,
                "base_factor": _number(pbr, "base_factor"),
                "roughness": _number(pbr, "roughness"),
                "metalness": _number(pbr, "metalness"),
                "opacity": _number(pbr, "opacity"),
                "emission": list(get(pbr, "emission_color").value_vec4),
                "emission_factor": _number(pbr, "emission_factor"),
                "transparency": list(get(material, "fbx.transparency_color").value_vec4),
                "transparency_factor": _number(hold(material.fbx), "transparency_factor"),
                "textures": len(hold(material.textures)),
                "picture": picture,
            }
        )
    return facts


def _number(maps, name):
    value = hold(getattr(maps, name))
    return value.value_vec4.x if value.has_value else None


def key_range(stack):
    """Times of the first and the last key of a stack, and how many of its curves have any."""
    first, last, count = math.inf, -math.inf, 0
    for layer in items(hold(stack.layers)):
        for value in items(hold(layer.anim_values)):
            for curve in hold(value.curves):
                if curve is not None and len(hold(curve.keyframes)):
                    first, last = min(first, curve.min_time), max(last, curve.max_time)
                    count += 1
                hold(curve)
    return first, last, count


def frame_times(record, begin, end, rate, where):
    """Times of all frames from ``begin`` to ``end``, which itself is one."""
    if not (math.isfinite(begin) and math.isfinite(end)) or (end - begin) * rate > MOST_FRAMES:
        record.refuse(where, f"it lasts {end - begin:g} s, more than {MOST_FRAMES:,} frames")
    slack = 1e-4
    first = round(begin * rate)
    count = math.floor((end - begin) * rate + slack)
    if abs(begin * rate - first) < slack:  # the very times that the file's keys have
        times = [(first + k) / rate for k in range(count + 1)]
    else:
        times = [begin + k / rate for k in range(count + 1)]
    if (end - times[-1]) * rate > slack:
        times.append(end)
    return times


def read_stacks(record, scene, nodes, rate, evaluate):
    """Every stack with all its layers, evaluated at the frames of the file."""
    channels = items(hold(scene.blend_channels))
    facts, samples = [], 0
    for stack in items(hold(scene.anim_stacks)):
        where = f"animation stack '{stack.name}'"
        anim = hold(stack.anim)
        first, last, curves = key_range(stack)
        begin, end = stack.time_begin, stack.time_end
        if not end > begin and last > first:
            begin, end = first, last
        item = {"name": stack.name, "layers": len(hold(stack.layers)), "curves": curves, "begin": begin, "end": end}
        item["keys"] = [first, last] if curves else None
        item["tracks"], item["weights"] = [], []
        facts.append(item)
        if not curves:
            continue
        times = frame_times(record, begin, end, rate, where)
        animated = evaluate.animated(stack)
        samples += len(times) * (len(nodes) + len(channels))
        if samples > MOST_SAMPLES:
            record.refuse(where, f"{len(times):,} frames of {len(nodes):,} nodes are too many")
        item["times"] = record.reals(times)
        for index, node in enumerate(nodes):
            if node.is_root:
                continue
            found = evaluate.transforms(stack, anim, node, times, animated)
            track = {"node": index}
            for name in ("translation", "rotation", "scale"):
                values = [getattr(value, name) for value in found]
                start = values[0]
                if all(value == start for value in values):
                    values = [start]
                track[name] = record.reals(chain.from_iterable(values), len(start))
            item["tracks"].append(track)
        for index, channel in enumerate(channels):
            values = [channel.weight] * len(times)
            if channel.element_id in animated:
                values = [evaluate.blend_weight(anim, channel, t) for t in times]
            item["weights"].append({"channel": index, "values": record.reals(values)})
    return facts


class Evaluate:
    """Local transforms and blend weights; what ufbx 0.0.5 gets wrong is put right."""

    def __init__(self, ufbx, nodes):
        self._ufbx = ufbx
        self.blend_weight = ufbx.evaluate_blend_weight
        self._helpers = any(node.is_scale_helper for node in nodes)
        self.notes = []
        self._orders = {n.typed_id: IgnoredOrder(ufbx, n) for n in nodes if IgnoredOrder.holds(n)}

    def rest(self, node):
        """The transform of a node that nothing animates."""
        order = self._orders.get(node.typed_id)
        return node.local_transform if order is None else order.applied(node.local_transform, order.rest_angles)

    @staticmethod
    def animated(stack):
        """The names of the properties that a stack animates, by the numbers of their elements."""
        found = {}
        for layer in items(hold(stack.layers)):
            for prop in items(hold(layer.anim_props)):
                found.setdefault(hold(prop.element).element_id, set()).add(prop.prop_name)
        return found

    def transforms(self, stack, anim, node, times, animated):
        """The transforms of a node at some times; only one, its rest, where the stack does not animate it.

        For a property that a stack does not animate ufbx 0.0.5 now and then takes the keys of another element, so what
        cannot move is put back to rest.
        """
        names = animated.get(node.element_id, set())
        if self._helpers:  # nodes that move with the scale of another, which no property of theirs tells
            return self._evaluated(stack, anim, node, times)
        if not names:
            return [self.rest(node)]
        rest, found = self.rest(node), self._evaluated(stack, anim, node, times)
        still_place, still_turn, still_size = (f"Lcl {n}" not in names for n in ("Translation", "Rotation", "Scaling"))
        arm = Arm(node) if _has_pivots(node) else None
        result = []
        for value in found:
            rotation = rest.rotation if still_turn else value.rotation
            scale = rest.scale if still_size else value.scale
            source = rest if still_place else value
            place = source.translation
            if arm is not None:  # what turns about a pivot moves, though nothing moves it
                ends = arm.end(rotation, scale), arm.end(source.rotation, source.scale)
                place = tuple(t + a - b for t, a, b in zip(place, *ends, strict=True))
            result.append(self._ufbx.Transform(place, rotation, scale))
        return result

    def _evaluated(self, stack, anim, node, times):
        evaluate = self._ufbx.evaluate_transform
        found = [evaluate(anim, node, t) for t in times]
        order = self._orders.get(node.typed_id)
        if order is None:
            return found
        curves = [hold(layer.find_anim_prop(node, "Lcl Rotation")) for layer in items(hold(stack.layers))]
        curves = [hold(curve.anim_value) for curve in curves if curve is not None]
        if len(curves) > 1:
            self.notes.append(
                f"node '{node.name}': several layers turn it by a rotation order that is not active; it was kept"
            )
            return found
        angles = [curves[0].evaluate_vec3(t) for t in times] if curves else [order.rest_angles] * len(times)
        return [order.applied(value, turned) for value, turned in zip(found, angles, strict=True)]


class Arm:
    """The way from the point about which a node turns and scales to its origin."""

    def __init__(self, node):
        zero = (0.0, 0.0, 0.0)
        names = ("ScalingOffset", "ScalingPivot", "RotationPivot")
        self._offset, self._pivot, self._about = (_vector(node, name, zero) for name in names)
        self._back = _conjugate(node.adjust_post_rotation)

    def end(self, rotation, scale):
        """Where the arm points to with a local rotation and scale."""
        pairs = zip(self._offset, self._pivot, self._about, scale, strict=True)
        return _turned(_product(rotation, self._back), tuple(o + p * (1 - s) - a for o, p, a, s in pairs))


class IgnoredOrder:
    """A node with a rotation order that is not active, so that its angles are meant in the order XYZ."""

    ORDERS = ("XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX")

    def __init__(self, ufbx, node):
        self._transform, self._order = ufbx.Transform, self.ORDERS[int(node.rotation_order)]
        zero = (0.0, 0.0, 0.0)
        pivot, scale = _vector(node, "ScalingPivot", zero), _vector(node, "Lcl Scaling", (1.0, 1.0, 1.0))
        about, offset = _vector(node, "RotationPivot", zero), _vector(node, "ScalingOffset", zero)
        post = _of_angles(_vector(node, "PostRotation", zero), "XYZ")
        self._after = _product(_conjugate(post), node.adjust_post_rotation)
        self._arm = tuple(o + p * (1 - s) - a for o, p, s, a in zip(offset, pivot, scale, about, strict=True))
        self.rest_angles = _vector(node, "Lcl Rotation", zero)

    @staticmethod
    def holds(node):
        """Whether a node is such a one."""
        return 0 < int(node.rotation_order) < 6 and not hold(node.props).find_bool("RotationActive", False)

    def applied(self, value, angles):
        """A transform that ufbx has found with the order, as it is without."""
        turn = _product(_conjugate(_of_angles(angles, self._order)), _of_angles(angles, "XYZ"))
        rotation = _product(value.rotation, _product(_conjugate(self._after), _product(turn, self._after)))
        before, after = _turned(value.rotation, self._arm), _turned(rotation, self._arm)
        moved = tuple(t + a - b for t, a, b in zip(value.translation, after, before, strict=True))
        return self._transform(moved, rotation, value.scale)


def _has_pivots(node):
    """Whether turning or scaling a node also moves it."""
    zero = (0.0, 0.0, 0.0)
    names = ("RotationPivot", "RotationOffset", "ScalingPivot", "ScalingOffset")
    return any(any(_vector(node, name, zero)) for name in names)


def _vector(node, name, default):
    found = hold(hold(node.props).find_prop(name))
    return default if found is None else tuple(found.value_vec4)[:3]


# Quaternions as xyzw: ufbx's own functions do not take its own types.


def _of_angles(degrees, order):
    """The rotation by three angles about x, y and z, one after the other in an order about the axes of the parent."""
    result = (0.0, 0.0, 0.0, 1.0)
    for axis in order:
        index = "XYZ".index(axis)
        half = math.radians(degrees[index]) / 2
        single = [0.0, 0.0, 0.0, math.cos(half)]
        single[index] = math.sin(half)
        result = _product(single, result)
    return result


def _product(a, b):
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _conjugate(q):
    return (-q[0], -q[1], -q[2], q[3])


def _turned(q, v):
    return _product(_product(q, (*v, 0.0)), _conjugate(q))[:3]


def start():
    """Import the library."""
    global ufbx
    gc.disable()
    import ufbx


def reason(error):
    """Words for ufbx's errors."""
    if isinstance(error, ufbx.UfbxError):
        return {"error": str(error) or type(error).__name__, "where": "", "kind": type(error).__name__}
    return None


def understood(record, path):
    """What a file holds, in its own unit, Y up and facing +Z."""
    axis = ufbx.CoordinateAxis
    scene = hold(
        ufbx.load_file(
            path,
            space_conversion=ufbx.SpaceConversion.ADJUST_TRANSFORMS,
            target_axes=ufbx.CoordinateAxes(axis.POSITIVE_X, axis.POSITIVE_Y, axis.POSITIVE_Z),
            handedness_conversion_axis=ufbx.MirrorAxis.X,
            geometry_transform_handling=ufbx.GeometryTransformHandling.PRESERVE,
            inherit_mode_handling=ufbx.InheritModeHandling.COMPENSATE,
            scale_helper_name="scale",
            generate_missing_normals=True,
            normalize_normals=True,
            ignore_missing_external_files=True,
            node_depth_limit=DEPTH_LIMIT,
            file_format=ufbx.FileFormat.FBX,
        )
    )
    metadata, settings = hold(scene.metadata), hold(scene.settings)
    props = hold(settings.props)
    rate = settings.frames_per_second
    nodes = items(hold(scene.nodes))
    evaluate = Evaluate(ufbx, nodes)
    node_facts, rest = read_nodes(record, nodes, evaluate)
    deformers, channels, shapes = read_morphs(record, scene)
    facts = {
        "version": metadata.version,
        "ascii": bool(metadata.ascii),
        "creator": metadata.creator,
        "application": _application(metadata),
        "unit_m": settings.unit_meters,
        "up": [props.find_int("UpAxis", 1), props.find_int("UpAxisSign", 1)],
        "front": [props.find_int("FrontAxis", 2), props.find_int("FrontAxisSign", 1)],
        "right": [props.find_int("CoordAxis", 0), props.find_int("CoordAxisSign", 1)],
        "rate_hz": rate,
        "warnings": [[w.description, max(w.count, 1)] for w in items(hold(metadata.warnings))[:1000]],
        "nodes": node_facts,
        "rest": rest,
        "meshes": read_meshes(record, scene),
        "skins": read_skins(record, scene),
        "morph_deformers": deformers,
        "morph_channels": channels,
        "shapes": shapes,
        "materials": read_materials(record, scene),
        "dropped": {name: len(hold(getattr(scene, name))) for name in DROPPED},
    }
    if not (math.isfinite(rate) and 0 < rate <= 100_000):
        record.refuse("GlobalSettings", f"the frame rate is {rate:g} Hz")
    facts["stacks"] = read_stacks(record, scene, nodes, rate, evaluate)
    facts["notes"] = evaluate.notes[:1000]
    return facts


def _application(metadata):
    found = hold(metadata.latest_application)
    return f"{found.name} {found.version}".strip()
