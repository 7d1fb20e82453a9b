"""A small COLLADA file with much of what the format allows: a bending tube of two joints, a flag with a morph, a lamp."""

from __future__ import annotations


def source(name: str, values: str, width: int, kind: str = "float") -> str:
    array = {"float": "float_array", "name": "Name_array", "IDREF": "IDREF_array"}[kind]
    count = len(values.split())
    return (
        f'<source id="{name}"><{array} id="{name}-array" count="{count}">{values}</{array}><technique_common>'
        f'<accessor source="#{name}-array" count="{count // width}" stride="{width}"/></technique_common></source>'
    )


def sampler(name: str, times: str, values: str, words: str, target: str, width: int = 1, tangents: str = "") -> str:
    """An animation; ``tangents`` are those in and out, separated by a bar."""
    ins, _, outs = tangents.partition("|")
    more = inputs = ""
    for semantic, text in (("IN_TANGENT", ins), ("OUT_TANGENT", outs)):
        if text:
            more += source(f"{name}-{semantic}", text, len(text.split()) // len(times.split()))
            inputs += f'<input semantic="{semantic}" source="#{name}-{semantic}"/>'
    return (
        f'<animation id="{name}">{source(f"{name}-in", times, 1)}{source(f"{name}-out", values, width)}'
        f'{source(f"{name}-words", words, 1, "name")}{more}<sampler id="{name}-sampler">'
        f'<input semantic="INPUT" source="#{name}-in"/><input semantic="OUTPUT" source="#{name}-out"/>'
        f'<input semantic="INTERPOLATION" source="#{name}-words"/>{inputs}</sampler>'
        f'<channel source="#{name}-sampler" target="{target}"/></animation>'
    )


BEZIER = sampler(
    "bend", "0 1 2", "0 60 -30", "BEZIER BEZIER BEZIER", "elbow/rotateZ.ANGLE",
    tangents="-0.2 0 0.9 60 1.5 -40|0.5 0 1.3 80 2.2 0",
)  # fmt: skip
HERMITE = sampler("slide", "0 2", "0 4", "HERMITE HERMITE", "arm/move.X", tangents="2 0 2 0|2 6 2 0")
STEP = sampler("hop", "0 1 2", "0 5 7", "STEP STEP STEP", "flag/place.Y")
WEIGHT = sampler("wave", "0 1", "0 1", "LINEAR LINEAR", "flag-weights(0)")

ANIMATIONS = BEZIER + HERMITE + STEP + WEIGHT

GEOMETRIES = (
    '<geometry id="tube" name="Tube"><mesh>'
    + source("tube-p", "0 -1 0  0 1 0  2 -1 0  2 1 0  4 -1 0  4 1 0", 3)
    + source("tube-n", "0 0 2", 3)
    + source("tube-t", "0 0  0 1  0.5 0  0.5 1  1 0  1 1  0.5 0.25", 2)
    + '<vertices id="tube-v"><input semantic="POSITION" source="#tube-p"/></vertices>'
    '<polylist count="2" material="skin"><input semantic="VERTEX" source="#tube-v" offset="0"/>'
    '<input semantic="NORMAL" source="#tube-n" offset="1"/><input semantic="TEXCOORD" source="#tube-t" offset="2" set="0"/>'
    "<vcount>4 4</vcount><p>0 0 0 2 0 2 3 0 3 1 0 1  2 0 6 4 0 4 5 0 5 3 0 3</p></polylist></mesh></geometry>"
    '<geometry id="flag-base" name="Flag"><mesh>'
    + source("flag-p", "0 0 0  1 0 0  1 1 0  0 1 0  0.5 2 0", 3)
    + source("flag-c", "1 0 0 0 1 0 0 0 1 1 1 1 0 0 0", 3)
    + '<vertices id="flag-v"><input semantic="POSITION" source="#flag-p"/><input semantic="COLOR" source="#flag-c"/></vertices>'
    '<polygons count="1" material="cloth"><input semantic="VERTEX" source="#flag-v" offset="0"/><p>0 1 2 4 3</p></polygons>'
    '<tristrips count="1" material="cloth"><input semantic="VERTEX" source="#flag-v" offset="0"/><p>0 1 3 2</p></tristrips>'
    '<trifans count="1" material="other"><input semantic="VERTEX" source="#flag-v" offset="0"/><p>0 1 2 3</p></trifans>'
    '<lines count="1"><input semantic="VERTEX" source="#flag-v" offset="0"/><p>0 1</p></lines></mesh></geometry>'
    '<geometry id="flag-blown" name="blown"><mesh>'
    + source("blown-p", "0 0 0  1 0 3  1 1 3  0 1 0  0.5 2 0", 3)
    + '<vertices id="blown-v"><input semantic="POSITION" source="#blown-p"/></vertices></mesh></geometry>'
)

CONTROLLERS = (
    '<controller id="tube-skin"><skin source="#tube"><bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</bind_shape_matrix>'
    + source("skin-j", "J0 J1", 1, "name")
    + source("skin-b", "1 0 0 0 0 1 0 0 0 0 1 -5 0 0 0 1   1 0 0 -2 0 1 0 0 0 0 1 -5 0 0 0 1", 16)
    + source("skin-w", "1 0.5 0.25", 1)
    + '<joints><input semantic="JOINT" source="#skin-j"/><input semantic="INV_BIND_MATRIX" source="#skin-b"/></joints>'
    '<vertex_weights count="6"><input semantic="JOINT" source="#skin-j" offset="0"/>'
    '<input semantic="WEIGHT" source="#skin-w" offset="1"/><vcount>1 1 2 2 1 2</vcount>'
    "<v>0 0 0 0 0 1 1 1 0 1 1 1 1 0 0 2 1 2</v></vertex_weights></skin></controller>"
    '<controller id="flag-morph"><morph source="#flag-base" method="NORMALIZED">'
    + source("flag-targets", "flag-blown", 1, "IDREF")
    + source("flag-weights", "0.25", 1)
    + '<targets><input semantic="MORPH_TARGET" source="#flag-targets"/>'
    '<input semantic="MORPH_WEIGHT" source="#flag-weights"/></targets></morph></controller>'
)

MATERIALS = (
    '<library_effects><effect id="red-fx"><profile_COMMON><technique sid="t"><phong><emission><color>0 0.5 0 1</color></emission>'
    "<diffuse><color>0.9 0.1 0.2 1</color></diffuse></phong></technique></profile_COMMON></effect></library_effects>"
    '<library_materials><material id="red" name="Red"><instance_effect url="#red-fx"/></material></library_materials>'
)

NODES = (
    '<node id="arm" sid="J0" name="arm" type="JOINT"><translate sid="move">0 0 0</translate>'
    '<node id="elbow" sid="J1" name="elbow" type="JOINT"><translate>2 0 0</translate>'
    '<rotate sid="rotateZ">0 0 1 0</rotate><rotate>1 0 0 0</rotate></node></node>'
    '<node id="tube-node"><instance_controller url="#tube-skin"><skeleton>#arm</skeleton><bind_material><technique_common>'
    '<instance_material symbol="skin" target="#red"/></technique_common></bind_material></instance_controller></node>'
    '<node id="flag" name="flag"><rotate>0 0 1 90</rotate><translate sid="place">10 0 0</translate><scale>1 2 1</scale>'
    '<instance_controller url="#flag-morph"/></node>'
    '<node id="looker" type="JOINT"><lookat>1 2 3  1 2 0  0 1 0</lookat></node>'
    '<node id="lamp"><instance_light url="#sun"/></node>'
    '<node id="pair"><instance_node url="#spare"/><instance_node url="#spare"/></node>'
)

LIBRARY = (
    '<library_nodes><node id="spare" name="spare" type="JOINT"><translate>0 3 0</translate></node></library_nodes>'
)


def collada(
    *, nodes: str = NODES, animations: str = ANIMATIONS, up: str = "Z_UP", meter: str = "0.01", clips: str = ""
) -> str:
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">\n'
        f'<asset><unit meter="{meter}"/><up_axis>{up}</up_axis></asset>\n{MATERIALS}\n'
        f"<library_geometries>\n{GEOMETRIES}\n</library_geometries>\n<library_controllers>\n{CONTROLLERS}\n</library_controllers>\n"
        f"<library_animations>\n{animations}\n</library_animations>\n{clips}\n{LIBRARY}\n"
        f'<library_visual_scenes><visual_scene id="main" name="test">\n{nodes}\n</visual_scene></library_visual_scenes>\n'
        '<scene><instance_visual_scene url="#main"/></scene>\n</COLLADA>\n'
    ).replace("><", ">\n<")
