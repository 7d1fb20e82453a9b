"""The operators of `keypose.editing` as pages know them, and running one on a clip of the project."""

from __future__ import annotations

from dataclasses import replace

from keypose.errors import ShapeError
from keypose.model import Document, Skeleton
from keypose.studio.edit_messages import OperatorParameter, OperatorSpec
from keypose.studio.edit_wire import Operation


def operator_specs() -> list[OperatorSpec]:
    """All operators, as their forms are drawn from."""
    from keypose.editing.operators import OPERATORS

    return [
        OperatorSpec(
            name=operator.name,
            label=operator.label,
            group=operator.needs,
            help=operator.description,
            parameters=[
                OperatorParameter(
                    name=p.name,
                    label=p.label or p.name,
                    kind=p.type,
                    default=p.default,
                    low=p.minimum,
                    high=p.maximum,
                    unit=p.unit,
                    choices=list(p.choices),
                    help=p.description,
                )
                for p in operator.parameters
            ],
        )
        for operator in OPERATORS.values()
    ]


def operated(asked: Operation, document: Document) -> tuple[Document, str, str]:
    """The document after an operator on one of its clips, what the step is called, and what it says of its work.

    Raises:
        KeyposeError: where there is no such operator, clip or character, or it cannot be done.
    """
    from keypose.editing.operators import OPERATORS, run_operator
    from keypose.editing.selection import Selection
    from keypose.studio.rig_operators import ON_JOINTS, operate_on_rig, rig_of_clip

    clip = document.clip(asked.clip)
    keys = {channel: indices.tolist() for channel, indices in asked.keys.items() if indices is not None}
    selection = Selection(tuple(asked.keys) or None, keys or None, asked.start_s, asked.end_s)
    skeleton = _skeleton(asked, document)
    rig = rig_of_clip(document, asked.character, clip) if asked.operator in ON_JOINTS and asked.character else None
    if rig is not None:
        result = operate_on_rig(asked.operator, clip, rig, skeleton, selection, asked.parameters)
    else:
        result = run_operator(asked.operator, clip, skeleton, selection, asked.parameters)
    changed = replace(document, clips={**document.clips, clip.name: replace(result.clip, name=clip.name)})
    return changed, OPERATORS[asked.operator].label, result.report


def _skeleton(asked: Operation, document: Document) -> Skeleton:
    """Of the character that was named, else of the first."""
    if asked.character:
        return document.character(asked.character).skeleton
    first = next(iter(document.characters.values()), None)
    if first is None:
        raise ShapeError("operators need a skeleton to measure on; add a character first")
    return first.skeleton
