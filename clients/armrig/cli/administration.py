"""The commands for the administrator of a lab, and on this host and its devices."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shlex import join, quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError, OperationError
from armrig_core.process.options import CommandGroup, argument, group, option, preset
from armrig_core.process.signal_pipe import until_signal

from armrig.cli.next_step import say_next
from armrig.cli.options import Json, RigId, Verbose
from armrig.cli.printing import (
    agree,
    echo,
    inform,
    print_json,
    print_result,
    print_table,
    say,
    say_answer,
    say_more,
    spinner,
)
from armrig.lab import installation
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig_core.rig.firmware_image import FirmwareImage

    from armrig.lab.avrdude import SerialBoard
    from armrig.lab.installation import InstallationPlan, Part
    from armrig.lab.pki import Issued

BROWN_OUT = (
    "The brown-out fuse is not known: Optiboot does not read fuses. A new board has "
    "a brown-out level of 2.7 V, too low for 16 MHz; docs/hardware.md explains how to read and set "
    "it."
)
MOTOR = (
    "While a board is written, its pins are inputs: D9 and D7 float, and D13 blinks. Only the "
    "pull-downs of the wiring hold the motor at 0 V (docs/hardware.md). A partly written program "
    "may do anything, so unplug the motor."
)
_BAUD = 500_000  # of the firmware that is shipped


def doctor(
    rig: RigId = "1",
    connect: str | None = preset(
        None,
        "Socket of a daemon on this machine, unixsock-stream/PATH; other endpoints are refused.",
        "the configuration's [client] connect, otherwise the daemon on this machine",
        metavar="ENDPOINT",
    ),
    json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Show what degrades the timing here, and how to correct it.

    If a daemon answers on this machine, the command checks the rights of the daemon, otherwise the
    rights of this user. The exit code is 1 if a check fails.

    A note is a fact that cannot be checked or corrected here; it does not change the exit code.
    """
    from armrig.lab.doctor import brief, is_well
    from armrig.lab.doctor import doctor as examine_this_host

    checks = examine_this_host(rig, connect)
    if json:
        print_json(checks)
    else:
        say_answer("\n".join(map(str, checks)) if verbose else brief(checks))
        if not verbose:
            say_more("the result of each check")
    if not is_well(checks):
        raise typer.Exit(1)


def flash(
    port: str | None = preset(
        None, "Serial port of the board.", "the Uno, if only one is plugged in", metavar="DEVICE"
    ),
    image: str | None = preset(
        None,
        "Firmware of armrig to write: uno (the arm), tclab, heatshield or optoshield.",
        "uno",
        metavar="NAME",
    ),
    file: Path | None = preset(
        None, "Firmware file to write (Intel HEX).", "the file of --image", names="--hex FILE"
    ),
    baud: int = preset(_BAUD, "Speed of the firmware's serial line, in bit/s ([device] baud)."),
    dry_run: bool = preset(False, "Show the plan only, without opening the port."),
    yes: bool = preset(False, "Confirm that the motor is unplugged; do not ask."),
    json: Json = False,
) -> None:
    """Write the firmware to an Uno, and check what the board runs.

    The command uses avrdude and the board's boot loader, Optiboot, and verifies the written
    firmware. It refuses a port that a daemon uses, and a board with another boot loader.
    """
    from armrig_core.rig.firmware_image import image_path, read_image

    from armrig.lab import avrdude

    show: Callable[[str], object] = (lambda _: None) if json else say
    if image is not None and file is not None:
        raise typer.BadParameter("--image and --hex exclude each other")
    firmware = read_image(file or image_path(image or "uno"))
    size = len(firmware.data)
    if size > avrdude.FLASH_BYTES:
        has = f"an {avrdude.CHIP} has room for {avrdude.FLASH_BYTES}"
        raise InputError(f"{firmware.path}: {size} B, but {has}")
    program = avrdude.find()
    board = avrdude.choose_board(port, avrdude.usb_boards())
    call = avrdude.command(program, port=board.port, image=firmware.path)
    about = {"path": str(firmware.path), "bytes": size, "crc": f"{firmware.crc:08x}"}
    about["sha256"] = firmware.sha256
    facts = {"port": board.port, "board": board.name, "firmware": about, "command": call}
    plan = (
        f"board     {board.name} at {board.port}\n"
        f"firmware  {firmware.path}\n"
        f"          {size} B, CRC-32 {firmware.crc:08x}, sha256 {firmware.sha256}\n"
        f"command   {join(call)}"
    )
    show(plan)
    if not dry_run:
        with avrdude.lock_port(board):
            show(MOTOR)
            agree("Is the motor unplugged? Write the board?", yes=yes)
            with spinner("asking the boot loader"):
                facts["loader"] = f"Optiboot {avrdude.loader(program, board.port)}"
            show(f"loader    {facts['loader']}")
            show(BROWN_OUT)
            with spinner("flash:") as moved:
                avrdude.write(call, moved)
            show("written; the board returned the same bytes")
            facts["device"], identity = _device(board, firmware, baud)
            show(identity)
    if json:
        print_json(facts)
    elif not dry_run:
        say_next("conformance", port=quote(board.port))


def _device(board: SerialBoard, firmware: FirmwareImage, baud: int) -> tuple[dict[str, Any], str]:
    """Return the identity that the board reports, as JSON fields and as a line."""
    from armrig_protocol.messages import State

    from armrig.lab.avrdude import greeting

    with spinner("waiting for the board"):
        device = greeting(board.port, baud)
    if device is None:
        raise OperationError(
            f"{board.port}: the firmware was written, but does not answer at {baud} baud; was it "
            "built for another speed (--baud), or is this another board?"
        )
    if device.firmware != firmware.crc:
        raise OperationError(
            f"the board reports the firmware {device.firmware:08x}, but {firmware.crc:08x} was "
            "written; flash the board again"
        )
    facts = {"firmware": f"{device.firmware:08x}", "version": device.version}
    facts |= {"uid": f"{device.uid:x}", "state": State(device.state).name}
    volts = "it drives the motor" if device.state == State.RUN else "0 V"
    return facts, (
        f"the board reports: firmware {device.firmware:08x}, protocol {device.version}, "
        f"uid {device.uid:x}, {State(device.state).name}, {volts}"
    )


def conformance(
    device: Annotated[str, option("--device DEVICE", "Serial port of the device.")],
    baud: int = preset(_BAUD, "Speed of the line, in bit/s."),
    motor_unplugged: bool = preset(False, "Confirm that the motor is unplugged; do not ask."),
    json: Json = False,
) -> None:
    """Test a device against PROTOCOL.md, with the motor unplugged.

    The test takes a minute and prints a line for each rule of PROTOCOL.md. The exit code is 0 only
    if no rule is broken.

    At the end, the device is at 0 V.
    """
    program = [sys.executable, "-m", "armrig_daemon", "conformance", "--device", device]
    program += ["--baud", str(baud), *["--motor-unplugged"] * motor_unplugged, *["--json"] * json]
    # In place of this process: a signal must reach the process that holds the device.
    os.execv(program[0], program)


_ENTRY = re.compile(r"^- \*\*(?P<term>[^*]+)\*\*(?: \((?P<long>[^)]+)\))?: (?P<text>.+)$", re.M)
_MAX_OFFERED = 3
"""Largest number of similar terms in the message about an unknown term."""


def glossary(
    term: Annotated[str | None, argument("TERM", "Term to explain.", "a list of all terms")] = None,
    json: Json = False,
) -> None:
    """Explain a term of armrig in one sentence, or list all terms."""
    terms = read_terms(_page().read_text(encoding="utf-8"))
    sentences = {term: terms[term] for term in ([_matching_term(term, terms)] if term else terms)}
    lines = (f"{name}: {text}" for name, text in sentences.items())
    print_result(sentences, *(lines if term else terms), json=json)


def read_terms(page: str) -> dict[str, str]:
    """Return the terms of the page with their sentences."""
    return {
        entry["term"]: (f"{entry['long']}. " if entry["long"] else "") + entry["text"]
        for entry in _ENTRY.finditer(page)
    }


rigs = CommandGroup("List the descriptions of rigs, or check a description.", no_args_is_help=False)


@rigs.callback(invoke_without_command=True)
def list_rigs(context: typer.Context) -> None:
    """List the descriptions that come with armrig; `armrig rigs check FILE` checks another."""
    from armrig_core.rig.description import builtin_files, read_description

    if context.invoked_subcommand is None:
        for path in builtin_files():
            echo(f"{path.stem:10} {read_description(path).rig.title}")
        inform("`armrig lab --rig-file NAME` emulates a rig; `armrig rigs check NAME` shows it")


@rigs.add("rigs check heater.toml", "check")
def check_rig(
    file: Annotated[Path, argument("FILE", "Description (TOML), or a name of `armrig rigs`.")],
    json: Json = False,
) -> None:
    """Check the description of a rig, and print how it was understood.

    A file of own equations is executed.
    """
    from armrig_core.rig.description import path_of, read_description

    from armrig.excitation.pace import pace_of

    described = read_description(path_of(file))
    rows = described.rows()
    if described.model and not described.arm:
        try:
            with spinner("simulating the model"):
                paced = pace_of(described).row
        except (InputError, OperationError) as err:
            paced = f"no demo: {err}"
        rows.insert(-1, ("experiments", paced))
    if json:
        print_json(dict(rows))
    else:
        print_table(*rows)


def _page() -> Path:
    """Return the path of the page, in the wheel or in the checkout."""
    packaged = Path(__file__).parents[1] / "glossary.md"
    return packaged if packaged.is_file() else Path(__file__).parents[3] / "docs" / "glossary.md"


def _matching_term(term: str, terms: dict[str, str]) -> str:
    """Return the term that a text means, in any case and hyphenation, also in the plural."""
    from difflib import get_close_matches

    names = {_plain(name): name for name in terms}
    wanted = _plain(term)
    for form in (wanted, wanted.removesuffix("s")):
        if form in names:
            return names[form]
    containing = [name for name in names if wanted and wanted in name]
    near = list(dict.fromkeys([*containing, *get_close_matches(wanted, names)]))[:_MAX_OFFERED]
    offered = ", ".join(names[name] for name in near)
    way_out = f"nearest: {offered}" if near else "`armrig glossary` lists all terms"
    raise InputError(f"{term}: not in the glossary; {way_out}")


def _plain(term: str) -> str:
    return " ".join(re.split(r"[\s_-]+", term.strip().casefold()))


service = CommandGroup(
    "Install, remove or show the systemd service of the rigs.", no_args_is_help=True
)
Root = Annotated[
    Path,
    option(
        "--root DIR", "Root folder of the system; a folder other than / contains an offline system."
    ),
]
DryRun = Annotated[bool, option("--dry-run", "Show the plan only.")]
Yes = Annotated[bool, option("--yes", "Do not ask.")]
_SYSTEM = Path("/")
_UNITS: dict[Part, str] = {
    "rig": "armrigd@1",
    "router": "armrig-router",
    "recorder": "armrig-recorder",
}
_NEEDED: dict[Part, str] = {
    "rig": "each rig needs its file, such as /etc/armrig/1.toml with [device] port",
    "router": "the router needs router.pem and access.toml in /etc/armrig",
    "recorder": (
        "the recorder needs recorder.pem in /etc/armrig, and recorder.env with the line\n"
        "  ARMRIG_CLIENT_CONNECT=tls/lab.example.edu:7447"
    ),
}
"""For each part, the files that the administrator must add after its installation."""


@service.add("service install --dry-run")
def install(
    router: bool = preset(False, "Install a lab's router."),
    recorder: bool = preset(False, "Install the recorder of all rigs of a router."),
    root: Root = _SYSTEM,
    dry_run: DryRun = False,
    yes: Yes = False,
) -> None:
    """Install the service of the rigs, or of the router (--router) or recorder (--recorder).

    Before any change the command shows each new file, and the differences of each changed file. An
    existing installation is updated.
    """
    chosen: dict[Part, bool] = {"router": router, "recorder": recorder}
    parts = [part for part, is_chosen in chosen.items() if is_chosen] or ["rig"]
    if _carry_out(installation.installing(root.absolute(), parts), root, dry_run=dry_run, yes=yes):
        for part in parts:
            say(f"installed; {_NEEDED[part]}, then\n  systemctl enable --now {_UNITS[part]}")
        if "rig" in parts:
            say("and each operator must join the group: adduser NAME armrig")


@service.add("service uninstall --dry-run")
def uninstall(root: Root = _SYSTEM, dry_run: DryRun = False, yes: Yes = False) -> None:
    """Stop all rigs at 0 V and remove the service, the router and the recorder.

    Configurations, recordings, drop-ins and users stay.
    """
    plan = installation.uninstalling(root.absolute())
    if not (plan.first or plan.removed):
        say("\n".join([*plan.lines(), "nothing is installed"]))
        return
    if _carry_out(plan, root, dry_run=dry_run, yes=yes):
        left = ["/etc/armrig", "the recordings in /var/lib", *map(str, plan.kept)]
        say(f"removed; {', '.join(left)} and the users stay")


@service.add("service status")
def status(root: Root = _SYSTEM, json: Json = False) -> None:
    """Show the installed files, and the state of each rig, the router and the recorder."""
    parts = installation.parts_of(root.absolute()) or {"rig"}
    states = {str(file.path): file.state for file in installation.files(root.absolute(), parts)}
    units = installation.units_of(root.absolute())
    lines = [f"{state:9}  {path}" for path, state in states.items()]
    for unit in units:
        start = "starts with the machine" if unit.enabled else "does not start with the machine"
        how = f"{unit.active}: {unit.status}" if unit.status else unit.active
        lines.append(f"{unit.title}: {', '.join(part for part in (how, start) if part)}")
    missing = parts - {unit.part for unit in units}
    for part in (part for part in _UNITS if part in missing):
        problem = "no rig is served" if part == "rig" else f"no {part} runs"
        lines.append(f"{problem}: systemctl enable --now {_UNITS[part]}")
    facts = {"files": states, "rigs": [unit for unit in units if unit.rig]}
    print_result(facts | {u.part: u for u in units if not u.rig}, *lines, json=json)


def _carry_out(plan: InstallationPlan, root: Path, *, dry_run: bool, yes: bool) -> bool:
    """Show a plan, and carry it out if the user agrees; return True if it was carried out."""
    say("\n".join(plan.lines()))
    if dry_run:
        return False
    if root == _SYSTEM and os.geteuid() != 0:
        raise OperationError(
            "only root may do this: repeat it with sudo and the full path of armrig"
        )
    agree("Do this?", yes=yes)
    plan.carry_out(installation.run_command)
    return True


pki = CommandGroup("Make certificates for rigs and for people on a network.", no_args_is_help=True)
_PKI = Path("pki")
_USES = {
    "rig": "set it as [access] certificate",
    "router": "give it as armrig router's --certificate",
}
"""Use of a certificate by its role; the certificates of people have another use."""
Directory = Annotated[
    Path, option("--directory", "Folder of the authority, whose key must stay private.")
]
Days = Annotated[int, option("--days", "Validity, in days.", min=1, max=36500)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Issuing:
    """Options of the commands that make a certificate."""

    directory: Directory = _PKI
    days: Days = 365
    force: bool = preset(False, "Replace an existing file.")
    json: Json = False


Issuing = Annotated[_Issuing, group(_Issuing)]


@pki.add("pki ca")
def ca(
    directory: Directory = _PKI,
    days: Days = 3650,
    force: bool = preset(
        False, "Replace an existing authority; all its certificates become invalid."
    ),
    json: Json = False,
) -> None:
    """Make a certificate authority, which signs all certificates, and an empty access list."""
    from armrig.lab.pki import ACCESS_LIST, make_authority

    path = make_authority(directory, days=days, force=force)
    print_result(
        {"path": path},
        f"{path}: made; keep {path.with_suffix('.key')} private, because with it "
        "anybody can make operators",
        f"{directory / ACCESS_LIST}: the access list, still empty",
        json=json,
    )


@pki.add("pki rig 1 --host rig-1.lab.example.edu")
def rig(
    *,
    name: Annotated[str, argument("ID", "Id of the rig.")],
    host: list[str] | None = preset(
        None,
        "Host name or address that clients use; repeatable.",
        "none, clients connect through a router",
    ),
    issuing: Issuing,
) -> None:
    """Make the certificate of a rig's daemon, for clients and for a router."""
    from armrig.lab.pki import issue_to_rig

    _issue(issue_to_rig, issuing, name, host or ())


@pki.add("pki router --host lab.example.edu", "router")
def of_router(
    host: Annotated[
        list[str], option("--host", "Host name or address that rigs and people use; repeatable.")
    ],
    issuing: Issuing,
) -> None:
    """Make the certificate of a lab's router."""
    from armrig.lab.pki import issue_to_router

    _issue(issue_to_router, issuing, host)


@pki.add("pki operator anna")
def operator(
    name: Annotated[
        str,
        argument("NAME", "Name of a person: a-z, 0-9 and -; the rig shows this name as the owner."),
    ],
    issuing: Issuing,
) -> None:
    """Make the certificate of a person who may drive and watch the rigs."""
    from armrig.lab.pki import issue_to_person

    _issue(issue_to_person, issuing, name, "operators")


@pki.add("pki observer wall-screen")
def observer(
    name: Annotated[str, argument("NAME", "Name of a person: a-z, 0-9 and -.")], issuing: Issuing
) -> None:
    """Make the certificate of a person who may watch the rigs."""
    from armrig.lab.pki import issue_to_person

    _issue(issue_to_person, issuing, name, "observers")


def _issue(issue: Callable[..., Issued], issuing: _Issuing, *whom: Any) -> None:
    issued = issue(issuing.directory, *whom, days=issuing.days, force=issuing.force)
    _say_issued(issued, json=issuing.json)


@pki.add("pki renew rig-1")
def renew(
    name: Annotated[
        str,
        argument(
            "NAME", "Name of a person, a rig or a router, as in `armrig pki list`, such as rig-1."
        ),
    ],
    issuing: Annotated[_Issuing, group(_Issuing, ("directory", "days", "json"))],
) -> None:
    """Renew the key and the certificate of a rig, a router or a person."""
    from armrig.lab.pki import renew as renewed

    _say_issued(renewed(issuing.directory, name, days=issuing.days), json=issuing.json)


@pki.add("pki revoke anna")
def revoke(
    name: Annotated[
        str, argument("NAME", "Name of a person or a rig, as in `armrig pki list`, such as rig-1.")
    ],
    directory: Directory = _PKI,
    json: Json = False,
) -> None:
    """Revoke all rights of a name permanently."""
    from armrig.lab.pki import ACCESS_LIST
    from armrig.lab.pki import revoke as revoked

    revoked(directory, name)
    effect = "this takes effect when the daemons of the rigs have this file and are restarted"
    text = f"{name}: revoked in {directory / ACCESS_LIST}; {effect}"
    print_result({"name": name, "revoked": True}, text, json=json)


@pki.add("pki list", "list")
def list_issued(directory: Directory = _PKI, json: Json = False) -> None:
    """List the certificates with name, purpose and expiry date."""
    from armrig.lab.pki import list_certificates

    certificates = list_certificates(directory)
    lines = [
        f"{certificate.name:40} {certificate.role:10} until {certificate.expires:%Y-%m-%d}"
        for certificate in certificates
    ]
    lines = lines or [f"{directory}: no certificates yet"]
    print_result([certificate._asdict() for certificate in certificates], *lines, json=json)


def _say_issued(issued: Issued, *, json: bool) -> None:
    use = _USES.get(issued.role, "set it as [client] certificate")
    print_result(
        issued._asdict(),
        f"{issued.path}: {issued.name}, {issued.role}, until {issued.expires:%Y-%m-%d}",
        f"the file contains the key, so only the owner of the file may read it; {use}",
        json=json,
    )


def router(
    listen: str = preset("tls/0.0.0.0:7447", "Endpoint for rigs and clients.", metavar="ENDPOINT"),
    certificate: Path = preset(
        Path("router.pem"), "Certificate file of the router, from `armrig pki router`."
    ),
    names: Path = preset(Path("access.toml"), "Access list, from `armrig pki`."),
) -> None:
    """Run the router of a lab, until Ctrl-C. Clients reach the rigs through it.

    A rig connects if its configuration names the router in [access]. A client connects with
    --connect. The access list contains the rights of each name. The router keeps no state and may
    be restarted at any time: rigs, clients and recorders connect again by themselves.
    """
    with until_signal() as ended:
        from armrig.lab.router import open_router

        session, people = open_router(listen, certificate, names)
        with session:
            inform(
                f"router at {listen}: {plural(len(people.rigs), 'rig')}, {len(people.operators)} "
                f"may drive and {len(people.observers)} may watch; Ctrl-C ends the router"
            )
            ended.wait()
