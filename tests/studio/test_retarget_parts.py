"""The retarget page's own logic in Node: the figure, changes of roles, and what is told of a motion, beside Python's."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from client_node import answers, client_program

from keypose import samples
from keypose.analysis import find_roles
from keypose.analysis.roles import REQUIRED, ROLES
from keypose.evaluate import world
from keypose.model import Skeleton

pytestmark = pytest.mark.slow

SCRIPT = """
import * as roles from "@/retarget/roles";
import * as figures from "@/retarget/figures";

/** A rig as the page has it, of plain lists. */
function rigOf({ names, parents, positions }) {
  return {
    names, parents, count: names.length, rest: null,
    index: (name) => names.indexOf(name),
    solve: (_, out) => positions.forEach((p, j) => out.set([1, 0, 0, 0, 1, 0, 0, 0, 1, ...p], 12 * j)),
  };
}

const answer = ({ what, given }) => {
  switch (what) {
    case "spots": return roles.SPOTS;
    case "size": return [roles.WIDTH, roles.HEIGHT];
    case "required": return [...roles.REQUIRED];
    case "labels": return roles.SPOTS.map(({ role }) => roles.labelOf(role));
    case "other": return roles.otherSide(given);
    case "assigned": return roles.assigned(...given);
    case "mirrored": return roles.mirrored(given.table, given.from, rigOf(given.rig));
    case "json": return roles.toJson(given);
    case "parsed": try { return roles.fromJson(...given); } catch (error) { return { error: error.message }; }
    case "doubt": return roles.doubtOf(...given);
    case "prefix": return roles.commonPrefix(given);
    case "groups": return figures.directionGroups(given);
    case "color": return figures.slideColor(given, "dark");
    case "lanes": return figures.contactLanes(given, "dark");
  }
};
"""

Ask = Callable[..., Any]


@pytest.fixture(scope="module")
def ask(tmp_path_factory: pytest.TempPathFactory) -> Ask:
    program = client_program(SCRIPT, tmp_path_factory.mktemp("retarget"))
    return lambda what, given=None: answers(program, {"what": what, "given": given})[0]


@pytest.fixture(scope="module")
def human() -> Skeleton:
    return samples.load("human").character.skeleton


def rig(skeleton: Skeleton, names: list[str] | None = None) -> dict[str, Any]:
    places = np.asarray(world(skeleton, skeleton.rest))[:, :3, 3]
    return {
        "names": names or list(skeleton.names),
        "parents": [int(p) for p in skeleton.parents],
        "positions": places.tolist(),
    }


def test_the_figure_has_every_role_once_where_it_can_be_hit(ask: Ask) -> None:
    spots, (width, height) = ask("spots"), ask("size")
    assert sorted(s["role"] for s in spots) == sorted(ROLES)
    assert sorted(ask("required")) == sorted(REQUIRED)
    places = np.array([(s["x"], s["y"]) for s in spots])
    assert places.min() > 5 and np.all(places < (width - 5, height - 5))
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + 1e3 * np.eye(len(places))
    assert apart.min() > 12  # the smallest dots reach 5 units around them
    assert len(set(ask("labels"))) == len(spots)
    at = {s["role"]: np.array((s["x"], s["y"])) for s in spots}
    for role in ROLES:
        mirrored = at[ask("other", role)] if role.startswith(("left", "right")) else at[role]
        assert mirrored == pytest.approx((width - at[role][0], at[role][1]))
    # seen from the front: its left is on the right; hands hang from arms, feet from legs
    assert at["left_hand"][0] > width / 2 and at["head"][1] < at["hips"][1] < at["left_foot"][1]


def test_a_joint_plays_one_role_and_a_role_is_played_by_one_joint(ask: Ask) -> None:
    table = {"hips": "a", "spine": "b", "head": "c"}
    assert ask("assigned", [table, "spine", "c"]) == {"hips": "a", "spine": "c"}
    assert ask("assigned", [table, "neck", "d"]) == {**table, "neck": "d"}
    assert ask("assigned", [table, "head", None]) == {"hips": "a", "spine": "b"}
    assert ask("assigned", [{**table, "tail:1": "t"}, "head", None])["tail:1"] == "t"


@pytest.mark.parametrize("named", [True, False])
def test_one_side_mirrored_is_the_other_by_names_or_by_places(ask: Ask, human: Skeleton, named: bool) -> None:
    names = list(human.names) if named else [f"j{n}" for n in range(human.joint_count)]
    whole = {role: names[j] for role, j in find_roles(human).roles.items()}
    for side, other in (("left", "right"), ("right", "left")):
        half = {role: joint for role, joint in whole.items() if not role.startswith(other)}
        assert ask("mirrored", {"table": half, "from": side, "rig": rig(human, names)}) == whole


def test_maps_are_those_of_the_command_line(ask: Ask, human: Skeleton) -> None:
    found = find_roles(human)
    table = {role: human.names[j] for role, j in found.roles.items()}
    assert json.loads(ask("json", table)) == json.loads(found.to_json(human))
    assert ask("parsed", [found.to_json(human), list(human.names)]) == table
    for text, told in (
        ("{", "no JSON"),
        ("[]", "no map"),
        ('{"hip": "Hips"}', "no role “hip”"),
        ('{"hips": "Hisp"}', "no joint “Hisp”"),
        ('{"hips": 3}', "no joint “3”"),
    ):
        assert told in ask("parsed", [text, list(human.names)])["error"]
    assert ask("parsed", ['{"tail:2": "Hips"}', list(human.names)]) == {"tail:2": "Hips"}


def test_how_far_a_role_is_to_be_trusted(ask: Ask) -> None:
    found = {"roles": {"hips": "a", "head": "b", "neck": "c"}, "confidence": {"hips": 1.0, "head": 0.7, "neck": 0.5}}
    found |= {"missing": ["spine"], "all_fours": False, "notes": []}
    table = {"hips": "a", "head": "b", "neck": "c", "spine": "x"}
    doubts = {role: ask("doubt", [role, table, found]) for role in table}
    assert doubts == {"hips": "sure", "head": "likely", "neck": "unsure", "spine": "set"}
    assert ask("doubt", ["spine", {}, found]) == "needed" and ask("doubt", ["jaw", {}, found]) == "none"


def test_what_all_names_begin_with_is_found(ask: Ask) -> None:
    assert ask("prefix", ["mixamorig:Hips", "mixamorig:Spine", "mixamorig:Head", "Camera"]) == "mixamorig:"
    assert ask("prefix", ["CC_Base_Hip", "CC_Base_Waist", "CC_Base_Head", "CC_Base_L_Foot"]) == "CC_Base_"
    assert ask("prefix", ["Hips", "LeftArm", "upper_arm.L"]) == ""


def test_figures_are_grouped_without_losing_any(ask: Ask) -> None:
    directions = {role: float(n) for n, role in enumerate(ROLES)}
    groups = ask("groups", directions)
    labels = [bone["label"] for group in groups for bone in group["bones"]]
    assert sorted(labels) == sorted(role.replace("_", " ") for role in ROLES)
    for group in groups:
        assert group["mean"] == pytest.approx(np.mean([bone["degrees"] for bone in group["bones"]]))
    by_label = {group["label"]: {bone["label"] for bone in group["bones"]} for group in groups}
    assert by_label["Legs"] == {"left upper leg", "right upper leg", "left lower leg", "right lower leg"}


def test_colours_go_from_still_to_sliding(ask: Ask) -> None:
    still, half, fast = (ask("color", speed) for speed in (0.0, 4.5, 50.0))
    assert len({still, half, fast}) == 3 and ask("color", 0.9) == still and ask("color", 8.0) == fast
    prints = {
        "source": [{"from": 0, "to": 1, "side": "left", "slide": 20}],
        "target": [{"from": 0, "to": 1, "side": "right", "slide": 0}],
    }
    assert ask("lanes", prints) == [
        {"label": "From", "spans": [[0, 1, fast, 1]]},
        {"label": "To", "spans": [[0, 1, still, 2]]},
    ]
    assert ask("lanes", {"source": [], "target": []}) == []
