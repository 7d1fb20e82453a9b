# pyright: basic, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false, reportOptionalSubscript=false
# pyright: reportArgumentType=false
"""What the guarded process (`keypose.io.guarded_child`) does to read USD with usd-core; keypose itself never imports it.

It hands over what the file says, as it says it: matrices in USD's own row-vector convention, quaternions as they lie in
memory (x, y, z, w), the unit and axes of the stage.
"""

import math
import os
from itertools import chain

MOST_PRIMS = 200_000
MOST_LAYERS = 500
MOST_SAMPLES = 50_000_000
MOST_FRAMES = 1_000_000
LAYERS = (".usd", ".usda", ".usdc")
KINDS = {"d": "d", "f": "f", "e": "e", "i": "i", "I": "I"}
SIZES = {"d": 8, "f": 4, "e": 2, "i": 4, "I": 4}


def start():
    """Import the library."""
    global Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel
    from pxr import Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel


def reason(error):
    """The library's first complaint, and the line that it names."""
    if isinstance(error, UnicodeDecodeError):
        return {"error": "a text is no UTF-8", "where": ""}
    if not isinstance(error, Tf.ErrorException):
        return None
    try:
        text = " ".join(str(error).split())
    except UnicodeDecodeError as broken:  # it quotes the file
        text = " ".join(broken.object.decode("utf-8", "replace").split())
    return {"error": text or "its structure is damaged", "where": ""}


def understood(record, path):
    """What a file holds."""
    notes = []
    layers = admitted_layers(record, path, notes)
    stage = Usd.Stage.Open(layers[0], Usd.Stage.LoadAll)
    prims = all_prims(record, stage)
    paths = {prim.GetPath(): number for number, prim in enumerate(prims)}
    bound = bindings(prims)
    materials = Materials()
    animations = [animation(record, prim) for prim in prims if prim.IsA(UsdSkel.Animation)]
    numbers = {a["path"]: n for n, a in enumerate(animations)}
    transforms = Transforms(record, stage)
    return {
        "layers": len(layers),
        "unit_m": UsdGeom.GetStageMetersPerUnit(stage),
        "has_unit": UsdGeom.StageHasAuthoredMetersPerUnit(stage),
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        "codes_per_s": stage.GetTimeCodesPerSecond(),
        "start": stage.GetStartTimeCode(),
        "end": stage.GetEndTimeCode(),
        "default": name_of(stage.GetDefaultPrim()) if stage.GetDefaultPrim() else "",
        "own": own_data(layers[0].customLayerData.get("keypose")),
        "prims": [transforms.of(prim, paths) for prim in prims],
        "skeletons": [skeleton(record, prim, paths, numbers) for prim in prims if prim.IsA(UsdSkel.Skeleton)],
        "animations": animations,
        "meshes": [
            mesh(record, prim, paths, bound, materials, notes)
            for prim in prims
            if prim.IsA(UsdGeom.Mesh) and shown(prim, notes)
        ],
        "materials": materials.facts,
        "dropped": dropped(prims),
        "notes": notes[:1000],
    }


# --- layers -----------------------------------------------------------------------------------------------------------


def admitted_layers(record, path, notes):
    """All layers that the stage is made of, the root first; what leads out of the file's own folder is cut off."""
    folder = os.path.realpath(os.path.dirname(path))
    layers, waiting, seen = [], [Sdf.Layer.FindOrOpen(path)], set()
    while waiting:
        layer = waiting.pop()
        if layer is None or layer.identifier in seen:
            continue
        seen.add(layer.identifier)
        layers.append(layer)
        if len(layers) > MOST_LAYERS:
            record.refuse("", f"it is made of more than {MOST_LAYERS} files")
        for asset in filter(None, layer.GetCompositionAssetDependencies()):  # nothing is the layer itself
            found = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
            if "[" not in found:  # what is not there comes back as it was asked for
                found = os.path.join(os.path.dirname(layer.realPath), found)
            if not is_inside(asset, found, path, folder):
                notes.append(f"'{asset[:200]}' leads out of the file's folder or is no USD file; it was not read")
                layer.SetPermissionToEdit(True)
                if not layer.UpdateCompositionAssetDependency(asset, ""):
                    record.refuse("", f"'{asset[:200]}' leads out of the file's folder")
            elif "[" not in found and not os.path.isfile(found):
                notes.append(f"'{asset[:200]}' is not there")
            else:
                waiting.append(opened(found, asset, notes))
    return layers


def opened(found, asset, notes):
    """A layer, or None where it is damaged."""
    try:
        return Sdf.Layer.FindOrOpen(found)
    except Tf.ErrorException:
        notes.append(f"'{asset[:200]}' is damaged and was not read")
        return None


def is_inside(asset, found, path, folder):
    """Whether a file that is asked for is a layer in the folder, or in the package, of the file that is read."""
    if asset.startswith("`"):  # an expression, which may become anything
        return False
    if "[" in found:
        package, _, inner = found.partition("[")
        inner = inner.rstrip("]")
        return os.path.realpath(package) == os.path.realpath(path) and is_layer(inner) and ".." not in inner.split("/")
    real = os.path.realpath(found)
    return is_layer(real) and real.startswith(os.path.join(folder, ""))


def is_layer(name):
    return os.path.splitext(name)[1].lower() in LAYERS


# --- prims ------------------------------------------------------------------------------------------------------------


def all_prims(record, stage):
    """Every prim of the stage, those of instances too."""
    found = []
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        if prim.IsPseudoRoot():
            continue
        if prim.HasAuthoredMetadata("clips"):
            record.refuse(str(prim.GetPath()), "it takes its samples from other files (value clips), which is not read")
        found.append(prim)
        if len(found) > MOST_PRIMS:
            record.refuse(str(prim.GetPath()), f"there are more than {MOST_PRIMS:,} prims")
    return found


def name_of(prim):
    """The name that is meant for people, else the prim's own."""
    return prim.GetDisplayName() or prim.GetName()


def own_data(value, depth=0):
    """What keypose has written, in JSON's terms."""
    if isinstance(value, dict) and depth < 8:
        return {str(k): own_data(v, depth + 1) for k, v in value.items()}
    if isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(value, "__iter__") and depth < 8:
        return [own_data(v, depth + 1) for v in value]
    return None


class Transforms:
    """Local transforms of prims, at rest and where they move."""

    def __init__(self, record, stage):
        self._record, self._left = record, MOST_SAMPLES
        self._first = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() else None

    def of(self, prim, paths):
        """A prim with its place in the hierarchy."""
        parent = prim.GetParent()
        item = {
            "path": str(prim.GetPath()),
            "name": name_of(prim),
            "type": str(prim.GetTypeName()),
            "parent": paths.get(parent.GetPath(), -1),
            "transform": None,
            "own": own_data(prim.GetCustomDataByKey("keypose")),
        }
        if not prim.IsA(UsdGeom.Xformable):
            return item
        xformable = UsdGeom.Xformable(prim)
        item["resets"] = bool(xformable.GetResetXformStack())
        times = xformable.GetTimeSamples() if xformable.TransformMightBeTimeVarying() else []
        turning = any("rotate" in str(op.GetOpName()) for op in xformable.GetOrderedXformOps())
        if times and turning and times[-1] - times[0] < MOST_FRAMES:
            # between keys angles turn otherwise than rotations do
            frames = range(math.ceil(times[0]), math.floor(times[-1]) + 1)
            times = sorted({*times, *(float(f) for f in frames)})
        self._left -= max(len(times), 1)
        if self._left < 0:
            self._record.refuse(item["path"], "its transforms have too many samples")
        matrices = [xformable.GetLocalTransformation(t) for t in times] or [
            xformable.GetLocalTransformation(Usd.TimeCode.EarliestTime())
        ]
        item["transform"] = self._record.reals(chain.from_iterable(chain.from_iterable(m) for m in matrices), 16)
        item["times"] = self._record.reals(times) if len(times) > 1 else None
        return item


def shown(prim, notes):
    """Whether a mesh is meant to be seen in a final picture."""
    imageable = UsdGeom.Imageable(prim)
    if imageable.ComputeVisibility(Usd.TimeCode.EarliestTime()) == UsdGeom.Tokens.invisible:
        notes.append(f"mesh '{name_of(prim)}': it is invisible and was left out")
        return False
    purpose = str(imageable.ComputePurpose())
    if purpose in ("guide", "proxy"):
        notes.append(f"mesh '{name_of(prim)}': it is a {purpose} and was left out")
        return False
    return True


def dropped(prims):
    """How many there are of kinds that are not read."""
    counts = {}
    for prim in prims:
        kind = str(prim.GetTypeName())
        unread = prim.IsA(UsdGeom.Gprim) and not prim.IsA(UsdGeom.Mesh)
        if unread or prim.IsA(UsdGeom.Camera) or kind == "PointInstancer" or kind.endswith("Light"):
            counts[kind] = counts.get(kind, 0) + 1
    return counts


# --- values -----------------------------------------------------------------------------------------------------------


def put(record, value, width):
    """An array of numbers in rows of ``width``; None for anything else."""
    try:
        view = memoryview(value)
    except TypeError:
        return None
    kind = KINDS.get(view.format)
    if kind is None or not view.nbytes:
        return None
    if view.nbytes // SIZES[kind] // view.shape[0] != width:
        return None
    return record.put(kind, view.tobytes(), width)


def still(attribute):
    """An attribute's own value, or that of its first sample."""
    if not attribute:
        return None
    value = attribute.Get()
    return attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value


def track(record, attribute, width, where):
    """Times and rows of a sampled array; one row without times where it has one value only."""
    if not attribute or not attribute.HasAuthoredValue():
        return None
    times = attribute.GetTimeSamples()
    values = [attribute.Get(t) for t in times] if times else [attribute.Get()]
    views, count, kind = [], None, None
    for value in values:
        try:
            view = memoryview(value)
        except TypeError:
            return {"wrong": True}
        size = view.nbytes // SIZES.get(view.format, 1)
        if (
            KINDS.get(view.format) is None
            or (count is not None and (size, view.format) != (count, kind))
            or size % width
        ):
            return {"wrong": True}
        count, kind = size, view.format
        views.append(view.tobytes())
    if (count or 0) * len(values) > MOST_SAMPLES:
        record.refuse(where, "it has too many samples")
    return {
        "times": record.reals(times),
        "rows": len(values),
        "values": record.put(KINDS[kind or "f"], b"".join(views), width),
    }


# --- skeletons and their animations -----------------------------------------------------------------------------------


def skeleton(record, prim, paths, animations):
    """Joints, bind and rest transforms, and the animation that drives them."""
    schema = UsdSkel.Skeleton(prim)
    source = UsdSkel.BindingAPI(prim).GetInheritedAnimationSource()
    return {
        "prim": paths[prim.GetPath()],
        "joints": tokens(schema.GetJointsAttr()),
        "names": tokens(schema.GetJointNamesAttr()),
        "bind": put(record, still(schema.GetBindTransformsAttr()), 16),
        "rest": put(record, still(schema.GetRestTransformsAttr()), 16),
        "animation": animations.get(str(source.GetPath()), -1) if source else -1,
    }


def tokens(attribute):
    """A list of words."""
    value = still(attribute)
    return [] if value is None or isinstance(value, str) or not hasattr(value, "__iter__") else [str(v) for v in value]


def animation(record, prim):
    """Sampled transforms of joints and weights of blend shapes."""
    schema = UsdSkel.Animation(prim)
    where = str(prim.GetPath())
    exact = prim.GetAttribute("keypose:scales")
    return {
        "path": where,
        "name": name_of(prim),
        "own": own_data(prim.GetCustomDataByKey("keypose")),
        "joints": tokens(schema.GetJointsAttr()),
        "shapes": tokens(schema.GetBlendShapesAttr()),
        "translations": track(record, schema.GetTranslationsAttr(), 3, where),
        "rotations": track(record, schema.GetRotationsAttr(), 4, where),
        "scales": track(record, exact or schema.GetScalesAttr(), 3, where),
        "weights": track(record, schema.GetBlendShapeWeightsAttr(), 1, where),
    }


def bindings(prims):
    """What UsdSkel finds to be deformed by which skeleton."""
    found, cache = {}, UsdSkel.Cache()
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    for prim in prims:
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, predicate)
            for binding in cache.ComputeSkelBindings(root, predicate):
                for query in binding.GetSkinningTargets():
                    found[query.GetPrim().GetPath()] = (binding.GetSkeleton().GetPrim(), query)
    return found


# --- meshes -----------------------------------------------------------------------------------------------------------


def mesh(record, prim, paths, bound, materials, notes):
    """Polygons as they are, with all that varies over them, the skin and the blend shapes."""
    schema = UsdGeom.Mesh(prim)
    name = name_of(prim)
    moving = schema.GetPointsAttr().GetNumTimeSamples()
    if moving > 1:
        notes.append(f"mesh '{name}': its vertices move by themselves ({moving} samples); only one shape was read")
    counts, corners = still(schema.GetFaceVertexCountsAttr()), still(schema.GetFaceVertexIndicesAttr())
    scheme = str(still(schema.GetSubdivisionSchemeAttr()) or "")
    subdivided = scheme not in ("", "none") and not schema.GetNormalsAttr().HasAuthoredValue()
    item = {
        "prim": paths[prim.GetPath()],
        "name": name,
        "own": own_data(prim.GetCustomDataByKey("keypose")),
        "positions": put(record, still(schema.GetPointsAttr()), 3),
        "counts": put(record, counts, 1),
        "corners": put(record, corners, 1),
        "holes": put(record, still(schema.GetHoleIndicesAttr()), 1),
        "left_handed": str(still(schema.GetOrientationAttr())) == "leftHanded",
        # viewers show both sides where nothing is said
        "double_sided": bool(still(schema.GetDoubleSidedAttr())) or not schema.GetDoubleSidedAttr().HasAuthoredValue(),
        "subdivision": subdivided,
        "primvars": primvars(record, schema, materials),
        "material": materials.bound_to(prim),
        "subsets": subsets(record, prim, materials),
        "skin": None,
        "shapes": shapes(record, prim),
        "skeleton": -1,
    }
    if prim.GetPath() in bound:
        skeleton_prim, query = bound[prim.GetPath()]
        item["skeleton"] = paths.get(skeleton_prim.GetPath(), -1)
        if query.HasJointInfluences():
            item["skin"] = skin(record, query)
    return item


def skin(record, query):
    """Joints and weights of points, or one set for all of them."""
    influences = query.ComputeJointInfluences()
    if not influences:
        return None
    order = query.GetJointOrder()
    return {
        "joints": put(record, influences[0], 1),
        "weights": put(record, influences[1], 1),
        "width": query.GetNumInfluencesPerComponent(),
        "constant": bool(query.IsRigidlyDeformed()),
        "order": [str(token) for token in order] if order is not None else None,
        "bind": list(chain.from_iterable(query.GetGeomBindTransform())),
        "method": str(query.GetSkinningMethod()),
    }


def primvars(record, schema, materials):
    """Normals, texture coordinates, colours and whatever else varies over a mesh."""
    found = []
    api = UsdGeom.PrimvarsAPI(schema.GetPrim())
    for primvar in api.GetPrimvarsWithValues():
        name = str(primvar.GetPrimvarName())
        if name.startswith("skel:"):
            continue
        item = values_over(record, primvar.GetAttr(), primvar.ComputeFlattened() if primvar.IsIndexed() else None)
        if item is not None:
            item |= {"name": name, "interpolation": str(primvar.GetInterpolation())}
            item["is_uv"] = str(primvar.GetTypeName()).startswith("texCoord2")
            found.append(item)
    if not any(item["name"] == "normals" for item in found):
        item = values_over(record, schema.GetNormalsAttr(), None)
        if item is not None:
            found.append(
                item | {"name": "normals", "interpolation": str(schema.GetNormalsInterpolation()), "is_uv": False}
            )
    return found


def values_over(record, attribute, flattened):
    """An array of numbers of any width."""
    value = still(attribute) if flattened is None else flattened
    try:
        view = memoryview(value)
    except TypeError:
        return None
    if KINDS.get(view.format) is None or not view.nbytes:
        return None
    width = view.nbytes // SIZES[view.format] // view.shape[0]
    return {"values": record.put(KINDS[view.format], view.tobytes(), width), "width": width}


def subsets(record, prim, materials):
    """Faces with a material of their own."""
    found = []
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        family, kind = str(still(subset.GetFamilyNameAttr()) or ""), str(still(subset.GetElementTypeAttr()) or "face")
        material = materials.bound_to(subset.GetPrim())
        faces = put(record, still(subset.GetIndicesAttr()), 1)
        if kind == "face" and faces is not None and (family == "materialBind" or (not family and material >= 0)):
            found.append({"name": name_of(subset.GetPrim()), "faces": faces, "material": material})
    return found


def shapes(record, prim):
    """Blend shapes with their in-betweens, in the order of their names."""
    api = UsdSkel.BindingAPI(prim)
    names = tokens(api.GetBlendShapesAttr())
    targets = api.GetBlendShapeTargetsRel().GetTargets() if api.GetBlendShapeTargetsRel() else []
    found = []
    for name, target in zip(names, targets, strict=False):
        shape = UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(target))
        if not shape:
            continue
        found.append(
            {
                "name": name,
                "points": put(record, still(shape.GetPointIndicesAttr()), 1),
                "keys": [
                    {
                        "weight": 1.0,
                        "offsets": put(record, still(shape.GetOffsetsAttr()), 3),
                        "normals": put(record, still(shape.GetNormalOffsetsAttr()), 3),
                    },
                    *(
                        {
                            "weight": between.GetWeight(),
                            "offsets": put(record, between.GetOffsets(), 3),
                            "normals": put(record, still(between.GetNormalOffsetsAttr()), 3),
                        }
                        for between in shape.GetInbetweens()
                        if between.GetWeight() is not None
                    ),
                ],
            }
        )
    return found


# --- materials --------------------------------------------------------------------------------------------------------


class Materials:
    """The materials that something is bound to."""

    def __init__(self):
        self.facts, self._known = [], {}

    def bound_to(self, prim):
        """The number of a prim's material; -1 for none."""
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not material:
            return -1
        path = material.GetPath()
        if path not in self._known:
            self._known[path] = len(self.facts)
            self.facts.append(self._facts(material))
        return self._known[path]

    def _facts(self, material):
        prim = material.GetPrim()
        item = {"name": name_of(prim), "own": own_data(prim.GetCustomDataByKey("keypose")), "inputs": {}, "kind": ""}
        source = material.ComputeSurfaceSource()
        shader = source[0] if source else None
        if not shader:
            return item
        item["kind"] = str(shader.GetShaderId() or "")
        for shader_input in shader.GetInputs():
            value = self._value(shader_input)
            if value is not None:
                item["inputs"][str(shader_input.GetBaseName())] = value
        return item

    def _value(self, shader_input):
        """A number, a colour, or the picture that it is taken from."""
        attributes = UsdShade.Utils.GetValueProducingAttributes(shader_input)
        if not attributes:
            return None
        attribute = attributes[0]
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output:
            return self._texture(UsdShade.Shader(attribute.GetPrim()), str(attribute.GetName()).rpartition(":")[2])
        return numbers(still(attribute))

    def _texture(self, shader, channel):
        if not shader or str(shader.GetShaderId()) != "UsdUVTexture":
            return None
        asset = self._input(shader, "file")
        if not isinstance(asset, Sdf.AssetPath):
            return None
        return {
            "asset": asset.path,
            "file": asset.resolvedPath,
            "channel": channel,
            "scale": numbers(self._input(shader, "scale")),
            "uvs": self._reader(shader),
        }

    def _input(self, shader, name):
        attributes = UsdShade.Utils.GetValueProducingAttributes(shader.GetInput(name)) if shader.GetInput(name) else []
        return still(attributes[0]) if attributes else None

    def _reader(self, shader):
        """The name of the texture coordinates that a texture is read with, and whether they are moved first."""
        found, moved = shader.GetInput("st"), False
        for _ in range(4):
            attributes = UsdShade.Utils.GetValueProducingAttributes(found) if found else []
            reader = UsdShade.Shader(attributes[0].GetPrim()) if attributes else None
            if not reader:
                break
            kind = str(reader.GetShaderId())
            if kind.startswith("UsdPrimvarReader"):
                name = self._input(reader, "varname")
                return {"name": str(name) if name is not None else "", "moved": moved}
            moved = moved or kind == "UsdTransform2d"
            found = reader.GetInput("in")
        return {"name": "", "moved": moved}


def numbers(value):
    """A number, or several, as a list."""
    if isinstance(value, (bool, int, float)):
        return [float(value)]
    try:
        return [float(v) for v in value]
    except (TypeError, ValueError):
        return None
