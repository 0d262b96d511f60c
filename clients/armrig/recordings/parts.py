"""The files of one run: a long run may be recorded in parts, which are read as one."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from armrig_core.errors import InputError
from armrig_core.manifest import OUTCOME, RECOVERED, RUN, Manifest

from armrig.recordings.container import Content


def joined(contents: Sequence[Content], manifests: Sequence[Manifest]) -> Content:
    """Return what consecutive parts of one run hold together.

    Raises
    ------
    ValueError
        They are of different runs, or one is missing.
    """
    for before, after in pairwise(manifests):
        if (before.rig, before.run_id) != (after.rig, after.run_id):
            raise InputError(
                f"run {after.run_id} of rig {after.rig} is not run {before.run_id} of rig "
                f"{before.rig}: only the parts of one run are joined"
            )
        if after.part != before.part + 1:
            raise InputError(
                f"part {after.part} does not follow part {before.part}: give the parts of a run "
                "in their order, with none left out"
            )
    whole = Content(
        sha256=hashlib.sha256("".join(c.sha256 for c in contents).encode()).hexdigest(),
        size=sum(c.size for c in contents),
        damage="; ".join(
            f"part {m.part}: {c.damage}"
            for c, m in zip(contents, manifests, strict=True)
            if c.damage
        ),
        cut_off=any(c.cut_off for c in contents),
        read=sum(c.read for c in contents),
        samples=np.concatenate([c.samples for c in contents]),
        metadata={RUN: contents[0].metadata[RUN]},
        attachments=contents[0].attachments,
        input=contents[0].input,
    )
    for content in contents:
        for stream, messages in content.messages.items():
            whole.messages.setdefault(stream, []).extend(messages)
        if RECOVERED in content.metadata:
            whole.metadata[RECOVERED] = content.metadata[RECOVERED]
    if OUTCOME in contents[-1].metadata:
        whole.metadata[OUTCOME] = contents[-1].metadata[OUTCOME]
    k = whole.samples["k"]
    if k.size and not (k[1:] > k[:-1]).all():
        raise InputError("the samples of one part do not stand behind those of the part before")
    return whole
