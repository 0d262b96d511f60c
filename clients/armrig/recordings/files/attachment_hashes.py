"""Comparison of a recording's attachments with the hashes in its manifest.

The comparison finds a mix-up. It does not find a forger, who can change the manifest, too.
"""

from __future__ import annotations

from hashlib import sha256

from armrig_core.recording_file.manifest import DESCRIPTION, RECOVERED, Manifest, Recovered

from armrig.recordings.files.container import Content

_SHOWN_DIGITS = 12
_WAY_OUT = "copy the recording again, from its rig or from a backup"


def attachment_names(content: Content, manifest: Manifest) -> set[str]:
    """Return the names of the attachments, including an input or reference that is damaged."""
    return {*content.attachments, *([manifest.source] if content.input else [])}


def attachment_fault(content: Content, manifest: Manifest) -> str:
    """Return the first difference of the attachments from the manifest's hashes; "" if none.

    An attachment without a hash is not compared. A missing description is a difference, because
    the recording would be read as that of the arm, unless a damage of the file explains it.
    """
    for name, recorded in manifest.attachment_hashes.items():
        digest = content.input_sha256 if name == manifest.source else ""
        if name in content.attachments:
            digest = sha256(content.attachments[name]).hexdigest()
        if digest and digest != recorded:
            return (
                f"the attachment '{name}' is not that of this run: its SHA-256 begins with "
                f"{digest[:_SHOWN_DIGITS]}, in the manifest with {recorded[:_SHOWN_DIGITS]}; "
                f"{_WAY_OUT}"
            )
        if name == DESCRIPTION and not digest and not _damage(content):
            return (
                f"the attachment '{name}' is missing, but the manifest contains its SHA-256: the "
                f"outputs of the rig are not known; {_WAY_OUT}"
            )
    return ""


def _damage(content: Content) -> str:
    if content.damage or RECOVERED not in content.metadata:
        return content.damage
    return Recovered.of(content.metadata[RECOVERED]).damage


def without_hash(content: Content, manifest: Manifest) -> tuple[str, ...]:
    """Return the names of the attachments without a hash in the manifest."""
    return tuple(sorted(attachment_names(content, manifest) - {*manifest.attachment_hashes}))
