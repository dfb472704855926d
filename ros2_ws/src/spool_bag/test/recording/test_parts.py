"""Recordings in parts: nothing is lost at a split, each part stands by itself, the quota is kept."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from spool_bag import recording as recording_module
from spool_bag import verification
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.part_records import DISTRUSTED, FILE_NAME, PartBegin
from spool_bag.parts import Output
from spool_bag.reader import BagReader
from spool_bag.recorder import Recorded
from spool_bag.recording import Recording, RecordingSettings, older, thin
from spool_bag.verification import TRIES, Verification, make_keys, signer, verify
from spool_bag.writer import BagWriter, PartLimits, RecordingError
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.errors import InputError

MakeBlock = Callable[..., Block]
KIND = "std_msgs/msg/String"
TEXT = b"\0\1\0\0\6\0\0\0hello\0"
OTHER_TEXT = b"\0\1\0\0\6\0\0\0again\0"
STEP = 20_000_000
START = 1_700_000_000_000_000_000
ONE_SECOND, TEN_SECONDS = PartLimits(duration=1.0), PartLimits(duration=10.0)


def recorded(folder: Path, block: MakeBlock, count: int, limits: PartLimits, **how: object) -> BagWriter:
    """Write ``count`` blocks, and one latched message at the beginning."""
    writer = BagWriter(folder, limits=limits, flush_interval=1e9, **how)
    channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    state = writer.add_topic("/valve_1/valve", KIND, latched=True)
    writer.write(state, START, TEXT)
    for sequence in range(count):
        writer.write(channel, START + sequence * STEP, encode_block(block(sequence), "valve_1"))
    return writer


def sequences(path: Path) -> list[int]:
    return [block.sequence for block in BagReader(path).blocks("valve_1")]


def test_nothing_is_lost_at_a_split_and_nothing_comes_twice(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 2000, TEN_SECONDS).close()
    assert sorted(path.name for path in tmp_path.glob("bag/*.mcap")) == [f"bag_{at}.mcap" for at in range(4)]
    assert sequences(tmp_path / "bag") == list(range(2000))
    reader = BagReader(tmp_path / "bag")
    assert len(list(reader.records("/valve_1/valve"))) == 1
    with AnyReader([tmp_path / "bag"]) as other:
        assert sum(1 for _ in other.messages([c for c in other.connections if "accel" in c.topic])) == 2000


def test_each_part_stands_by_itself(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 1600, TEN_SECONDS).close()
    for at in range(3):
        part = tmp_path / "alone" / f"bag_{at}.mcap"
        part.parent.mkdir(exist_ok=True)
        shutil.copy(tmp_path / "bag" / part.name, part)
        assert sequences(part) == list(range(500 * at, min(500 * at + 500, 1600)))
        assert [record.data for _, record in BagReader(part).records("/valve_1/valve")] == [TEXT]
        with part.open("rb") as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(sequences(part)) + 1
        with AnyReader([part]) as other:
            assert {c.topic for c in other.connections} == {"/valve_1/acceleration", "/valve_1/valve"}


def latched_in(part: Path) -> list[bytes]:
    return [record.data for _, record in BagReader(part).records("/valve_1/valve")]


def test_after_a_restart_each_further_part_holds_the_latched_messages(
    tmp_path: Path, block: MakeBlock
) -> None:
    recorded(tmp_path / "bag", block, 10, ONE_SECOND).close()
    again = BagWriter(tmp_path / "bag", limits=ONE_SECOND, resume=True)
    acceleration = again.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    again.write(again.add_topic("/valve_1/valve", KIND, latched=True), START + 10 * STEP, OTHER_TEXT)
    for sequence in range(10, 70):
        again.write(acceleration, START + sequence * STEP, encode_block(block(sequence), "valve_1"))
    again.close()
    held = [latched_in(tmp_path / "bag" / f"bag_{at}.mcap") for at in range(3)]
    assert held == [[TEXT], [OTHER_TEXT], [OTHER_TEXT]]


def test_the_metadata_is_true_for_what_is_there(tmp_path: Path, block: MakeBlock) -> None:
    writer = recorded(tmp_path / "bag", block, 2000, TEN_SECONDS)
    assert writer.remove_oldest()
    writer.close()
    told = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text("utf-8"))[
        "rosbag2_bagfile_information"
    ]
    names = [path.name for path in sorted((tmp_path / "bag").glob("*.mcap"))]
    assert told["relative_file_paths"] == names == ["bag_1.mcap", "bag_2.mcap", "bag_3.mcap"]
    assert told["message_count"] == sum(file["message_count"] for file in told["files"]) == 1500 + 3
    assert told["starting_time"]["nanoseconds_since_epoch"] == START + 500 * STEP - 1
    assert BagReader(tmp_path / "bag").warnings == []


def test_the_quota_is_never_exceeded_and_the_newest_stays(tmp_path: Path, block: MakeBlock) -> None:
    quota, most = 12_000_000, 0
    writer = BagWriter(tmp_path / "bag", limits=PartLimits(total=quota), flush_interval=1e9)
    channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    for sequence in range(6000):  # of 0.2 s each
        one = block(sequence, size=400)
        writer.write(channel, one.stamp, encode_block(one, "valve_1"))
        if sequence % 50 == 0:
            writer.flush()
            held = sum(path.stat().st_size for path in (tmp_path / "bag").glob("*.mcap"))
            most = max(most, held)
    writer.close()
    assert most <= quota
    assert writer.removed > 0
    kept = sequences(tmp_path / "bag")
    assert kept == list(range(kept[0], 6000))


def test_a_recording_goes_on_where_it_was_cut_off(tmp_path: Path, block: MakeBlock) -> None:
    first = recorded(tmp_path / "bag", block, 700, TEN_SECONDS)
    first.flush()  # a kill: neither index nor footer
    first.release()
    again = BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True)
    channel = again.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    for sequence in range(700, 900):
        again.write(channel, START + sequence * STEP, encode_block(block(sequence), "valve_1"))
    again.close()
    assert sequences(tmp_path / "bag") == list(range(900))
    assert verify(tmp_path / "bag").wrong == []


def test_an_edit_a_removal_and_an_exchange_are_named(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 2000, TEN_SECONDS).close()
    assert verify(tmp_path / "bag").wrong == []

    def changed(name: str, change: Callable[[Path], object]) -> list[str]:
        folder = tmp_path / name
        shutil.copytree(tmp_path / "bag", folder)
        change(folder)
        return verify(folder).wrong

    def edit(folder: Path) -> None:
        data = bytearray((folder / "bag_1.mcap").read_bytes())
        data[len(data) // 2] ^= 1
        (folder / "bag_1.mcap").write_bytes(data)

    def edit_index(folder: Path) -> None:
        """Change the topic's name in the summary, and leave out its checksum: readers go by it."""
        data = bytearray((folder / "bag_1.mcap").read_bytes())
        at = data.rindex(b"/valve_1/acceleration")
        data[at : at + 8] = b"/valve_9"
        data[-12:-8] = bytes(4)
        (folder / "bag_1.mcap").write_bytes(data)

    def exchange(folder: Path) -> None:
        (folder / "bag_1.mcap").rename(folder / "x")
        (folder / "bag_2.mcap").rename(folder / "bag_1.mcap")
        (folder / "x").rename(folder / "bag_2.mcap")

    edited = ["bag_1.mcap: it was edited: its SHA-256 is not the one in parts.sha256"]
    assert changed("edited", edit) == changed("index", edit_index) == edited
    assert changed("removed", lambda folder: (folder / "bag_1.mcap").unlink()) == ["part 1 was removed"]
    assert changed("first", lambda folder: (folder / "bag_0.mcap").unlink()) == ["part 0 was removed"]
    (last,) = changed("last", lambda folder: (folder / "bag_3.mcap").unlink())
    assert last.startswith("part 3 was removed")
    wrong = changed("exchanged", exchange)
    assert [line.partition(": its")[0] for line in wrong] == [
        "bag_1.mcap: it is part 2: it was renamed or exchanged",
        "bag_2.mcap: it is part 1: it was renamed or exchanged",
    ]
    assert changed("added", lambda folder: shutil.copy(folder / "bag_1.mcap", folder / "bag_9.mcap")) == [
        "bag_9.mcap: parts.sha256 does not name it: it was added, or its line was removed"
    ]


def changed_lists(text: str) -> list[str]:
    """Return a list of parts with each line changed in each way that somebody may try."""
    rows = text.splitlines()
    found = []
    for place, row in enumerate(rows):
        found += ["\n".join([*rows[:place], *rows[place + 1 :], ""])]
        for at in range(len(row)):
            other = "0" if row[at] != "0" else "1"
            found += ["\n".join([*rows[:place], row[:at] + other + row[at + 1 :], *rows[place + 1 :], ""])]
    return found


@pytest.mark.parametrize("signed", [False, True])
def test_each_line_of_the_list_that_was_edited_or_removed_is_named(
    tmp_path: Path, block: MakeBlock, signed: bool
) -> None:
    private, public = make_keys(tmp_path / "keys")
    sign = signer(str(private)) if signed else None
    recorded(tmp_path / "bag", block, 120, ONE_SECOND, sign=sign).close()
    path = tmp_path / "bag" / FILE_NAME
    text = path.read_text("ascii")
    assert len(text.splitlines()) == 1 + 3 + signed
    for changed in changed_lists(text):
        path.write_text(changed, "ascii")
        assert verify(tmp_path / "bag", public if signed else None).wrong, changed
    path.unlink()
    (line,) = verify(tmp_path / "bag").wrong
    assert line.startswith("parts.sha256: it is missing")


def test_a_list_without_its_newest_part_is_named_though_both_are_gone(
    tmp_path: Path, block: MakeBlock
) -> None:
    """Without the key nobody can sign the shorter list; metadata.yaml is changed as well."""
    private, public = make_keys(tmp_path / "keys")
    recorded(tmp_path / "bag", block, 120, ONE_SECOND, sign=signer(str(private))).close()
    (tmp_path / "bag" / "bag_2.mcap").unlink()
    path = tmp_path / "bag" / FILE_NAME
    rows = path.read_text("ascii").splitlines()
    path.write_text("\n".join([*rows[:3], rows[4], ""]), "ascii")
    told = tmp_path / "bag" / "metadata.yaml"
    told.write_text(told.read_text("utf-8").replace("bag_2.mcap", "bag_1.mcap"), "utf-8")
    (line,) = verify(tmp_path / "bag", public).wrong
    assert line.startswith("parts.sha256: its signature is not by the owner of spool_public.pem")


@pytest.mark.parametrize("signed", [False, True])
def test_a_recorder_vouches_for_no_list_that_was_edited_before_its_start(
    tmp_path: Path, block: MakeBlock, signed: bool
) -> None:
    private, public = make_keys(tmp_path / "keys")
    sign = signer(str(private)) if signed else None
    recorded(tmp_path / "bag", block, 120, ONE_SECOND, sign=sign).close()
    path = tmp_path / "bag" / FILE_NAME
    path.write_text(path.read_text("ascii").replace("\n1 ", "\n4 "), "ascii")
    BagWriter(tmp_path / "bag", limits=ONE_SECOND, resume=True, sign=sign).close()
    assert (tmp_path / "bag" / DISTRUSTED).is_file()
    wrong = verify(tmp_path / "bag", public if signed else None).wrong
    assert [line.partition(":")[0] for line in wrong] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]


def test_a_list_that_cannot_be_read_keeps_nothing_from_going_on(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 120, ONE_SECOND).close()
    (tmp_path / "bag" / FILE_NAME).unlink()
    (tmp_path / "bag" / FILE_NAME).mkdir()  # it raises an OSError, as a bad sector does
    with pytest.raises(InputError, match="cannot be read"):
        verify(tmp_path / "bag")
    BagWriter(tmp_path / "bag", limits=ONE_SECOND, resume=True).close()
    assert [line.partition(":")[0] for line in verify(tmp_path / "bag").wrong] == [
        f"bag_{part}.mcap" for part in range(3)
    ]


def test_a_recording_of_an_earlier_release_is_not_called_edited(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = PartBegin.content
    with monkeypatch.context() as earlier:
        earlier.setattr(PartBegin, "content", lambda one: {**content(one), "previous_sha256": "0" * 64})
        recorded(tmp_path / "bag", block, 120, ONE_SECOND).close()
    (tmp_path / "bag" / FILE_NAME).unlink()
    with pytest.raises(InputError, match="an earlier release recorded it"):
        verify(tmp_path / "bag")
    BagWriter(tmp_path / "bag", limits=ONE_SECOND, resume=True).close()
    found = verify(tmp_path / "bag")
    assert found.wrong == []
    assert [line.partition(":")[0] for line in found.notes] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]


def test_what_the_quota_removed_is_no_tampering(tmp_path: Path, block: MakeBlock) -> None:
    writer = recorded(tmp_path / "bag", block, 2000, TEN_SECONDS)
    assert writer.remove_oldest()
    found = verify(tmp_path / "bag")  # under way: neither closed nor split since
    assert found.wrong == []
    assert "the recorder's quota removed parts 0 to 0" in found.notes
    writer.close()
    found = verify(tmp_path / "bag")
    assert found.wrong == []
    assert found.notes == ["the recorder's quota removed parts 0 to 0"]


def test_a_list_made_anew_lacks_the_signature(tmp_path: Path, block: MakeBlock) -> None:
    private, public = make_keys(tmp_path / "keys")
    assert private.stat().st_mode & 0o077 == 0
    recorded(tmp_path / "bag", block, 1100, TEN_SECONDS, sign=signer(str(private))).close()
    found = verify(tmp_path / "bag", public)
    assert (found.wrong, found.signed) == ([], 3)
    recorded(tmp_path / "forged", block, 1100, TEN_SECONDS).close()
    (line,) = verify(tmp_path / "forged", public).wrong
    assert line.startswith("parts.sha256: it is not signed")
    other, _ = make_keys(tmp_path / "others")
    recorded(tmp_path / "other", block, 300, TEN_SECONDS, sign=signer(str(other))).close()
    assert "its signature is not by the owner of" in verify(tmp_path / "other", public).wrong[0]


class Quiet:
    def __init__(self) -> None:
        self.said: list[str] = []

    def info(self, message: str) -> None:
        self.said.append(message)

    def error(self, message: str) -> None:
        self.said.append(message)


def message(block: MakeBlock, sequence: int) -> Recorded:
    data = encode_block(block(sequence), "valve_1")
    return Recorded("/valve_1/acceleration", ACCELERATION_BLOCK, START + sequence * STEP, 1, data)


def put(one: Recording, block: MakeBlock, numbers: range) -> None:
    for sequence in numbers:
        one.put(message(block, sequence))


def wait_for(met: Callable[[], bool]) -> None:
    pause = threading.Event()
    for _ in range(18_000):
        if met():
            return
        pause.wait(0.01)
    raise AssertionError("waited in vain")


def fill(monkeypatch: pytest.MonkeyPatch, is_full: Callable[[], bool]) -> list[int]:
    """Let a disk take names but no bytes while ``is_full``, tried often; return how often it was tried."""
    tries, write = [0], Output.write

    def writes(output: Output, data: bytes) -> int:
        if is_full():
            tries[0] += 1
            raise OSError(28, "No space left on device")
        return write(output, data)

    monkeypatch.setattr(Output, "write", writes)
    monkeypatch.setattr(recording_module, "RETRY", 0.01)
    monkeypatch.setattr(recording_module, "LOOK", 0.01)
    return tries


def test_a_latched_message_that_came_during_a_pause_stands_in_each_further_part(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = [False]
    fill(monkeypatch, lambda: full[0])
    one = Recording(tmp_path / "bag", RecordingSettings(ONE_SECOND, flush_interval=0.05), Quiet())

    def put(sequence: int, *latched: bytes) -> None:
        for data in latched:
            received = START + sequence * STEP - 1
            one.put(Recorded("/valve_1/valve", KIND, received, received, data, latched=True))
        one.put(message(block, sequence))

    def pause(before: int, during: int, *latched: bytes) -> None:
        expected = one.state.messages + 2 + len(latched)
        full[0] = True
        put(before)
        wait_for(lambda: one.state.paused != "")
        put(during, *latched)
        full[0] = False
        wait_for(lambda: one.state.paused == "" and one.state.messages == expected)

    put(0, TEXT)
    wait_for(lambda: one.state.messages == 2)
    pause(1, 2, OTHER_TEXT)
    for sequence in range(3, 60):
        put(sequence)
    wait_for(lambda: one.state.messages == 62)
    pause(60, 61)
    for sequence in range(62, 120):
        put(sequence)
    assert one.close(180.0)
    held = [latched_in(tmp_path / "bag" / f"bag_{at}.mcap") for at in range(5)]
    assert held == [[TEXT], [TEXT, OTHER_TEXT], [OTHER_TEXT], [OTHER_TEXT], [OTHER_TEXT]]
    assert sequences(tmp_path / "bag") == list(range(120))


def test_a_disk_that_takes_names_but_no_bytes_gets_no_file_a_try(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = [False]
    tries = fill(monkeypatch, lambda: full[0])
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, flush_interval=0.05), Quiet())
    put(one, block, range(100))
    wait_for(lambda: one.state.messages == 100)
    full[0] = True
    put(one, block, range(100, 150))
    wait_for(lambda: tries[0] > 1)
    open_files = len(list(Path("/proc/self/fd").iterdir()))
    wait_for(lambda: tries[0] > 30)
    assert len(list(Path("/proc/self/fd").iterdir())) < open_files + 5
    assert [path.name for path in (tmp_path / "bag").glob("*.mcap")] == ["bag_0.mcap"]
    full[0] = False
    assert one.close(180.0)
    assert sequences(tmp_path / "bag") == list(range(150))
    assert one.lost == {}


def test_a_part_that_a_full_disk_left_empty_is_neither_kept_nor_listed(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(tmp_path / "bag", block, 100, TEN_SECONDS).close()
    full = [False]
    fill(monkeypatch, lambda: full[0])
    writer = BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True, flush_interval=1e9)
    channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    writer.write(channel, START + 100 * STEP, encode_block(block(100), "valve_1"))
    full[0] = True
    with pytest.raises(RecordingError, match=r"bag_1\.mcap.*No space left.*earlier data is kept"):
        writer.flush()
    assert [path.name for path in (tmp_path / "bag").glob("*.mcap")] == ["bag_0.mcap"]
    assert verify(tmp_path / "bag").wrong == []


def test_a_loss_is_stated_once_though_the_first_tries_to_state_it_fail(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = [False]
    tries = fill(monkeypatch, lambda: full[0])
    monkeypatch.setattr(recording_module, "LARGEST_QUEUE", message(block, 0).cost * 50)
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, flush_interval=0.05), Quiet())
    one.put(message(block, 0))
    wait_for(lambda: one.state.messages == 1)
    full[0] = True
    put(one, block, range(1, 101))
    wait_for(lambda: tries[0] > 30)
    full[0] = False
    wait_for(lambda: one.state.messages == 51)
    assert one.close(180.0)
    assert (one.state.lost, one.state.unstated) == (50, 0)
    assert sequences(tmp_path / "bag") == list(range(51))
    (told,) = [line for line in BagReader(tmp_path / "bag").warnings if "not recorded" in line]
    assert told.startswith("50 messages were not recorded before bag_1.mcap")


def test_a_disk_that_others_filled_gets_room_from_the_oldest_parts(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Filled between two looks, so that it pauses; then parts 0 and 1 make the room."""
    bag, filled = tmp_path / "bag", [False]

    def is_full() -> bool:
        return filled[0] and (bag / "bag_1.mcap").exists()

    tries = fill(monkeypatch, is_full)
    monkeypatch.setattr(recording_module, "_free", lambda _: 0 if tries[0] and is_full() else 10**12)
    one = Recording(bag, RecordingSettings(TEN_SECONDS, 10**9, flush_interval=0.05), Quiet())
    put(one, block, range(1600))
    wait_for(lambda: one.state.messages == 1600)
    filled[0] = True
    put(one, block, range(1600, 1700))
    wait_for(lambda: one.state.messages == 1700)
    assert one.state.removed == 2
    assert one.close(180.0)
    assert sequences(bag) == list(range(1000, 1700))


def test_what_finds_the_queue_full_meanwhile_is_stated(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [10**12]
    monkeypatch.setattr(recording_module, "_free", lambda _: free[0])
    room = message(block, 0).cost * 50
    monkeypatch.setattr(recording_module, "LARGEST_QUEUE", room)
    log = Quiet()
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, 10**9), log)
    one.put(message(block, 0))
    wait_for(lambda: one.state.messages == 1)
    free[0] = 10**6
    wait_for(lambda: "minimum_free_space" in one.state.paused)
    put(one, block, range(1, 101))
    assert one.state.lost == 50
    free[0] = 10**12
    wait_for(lambda: one.state.paused == "" and one.state.waiting == 0)
    one.put(message(block, 101))
    assert one.close(180.0)
    assert sequences(tmp_path / "bag") == [*range(51), 101]
    assert any("50 messages were not recorded" in line for line in log.said)
    (told,) = [line for line in BagReader(tmp_path / "bag").warnings if "not recorded" in line]
    assert told.startswith("50 messages were not recorded before bag_1.mcap: only 1 MB are free")


@pytest.mark.parametrize("cut", [True, False], ids=["cut back", "not even that"])
def test_a_disk_that_fails_once_costs_nothing_that_is_not_stated(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch, cut: bool
) -> None:
    failing, sync = [False], Output.sync

    def fails(output: Output) -> None:
        if failing[0]:
            failing[0] = False
            raise OSError(5, "Input/output error")
        sync(output)

    def no_cut(_: Output, __: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Output, "sync", fails)
    if not cut:
        monkeypatch.setattr(Output, "cut", no_cut)
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, flush_interval=0.2), Quiet())
    put(one, block, range(200))
    wait_for(lambda: one.state.messages == 200)
    failing[0] = True
    put(one, block, range(200, 300))
    wait_for(lambda: one.state.parts == 2)
    put(one, block, range(300, 400))
    assert one.close(180.0)
    kept = sequences(tmp_path / "bag")
    assert set(range(400)) - set(kept) == set()  # here the page cache kept what the disk did not confirm
    assert kept == sorted(set(kept)), "nothing comes twice"
    assert sum(one.lost.values()) <= (0 if cut else 100)


def test_a_part_that_cannot_be_begun_costs_nothing_and_nothing_comes_twice(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed: list[Path] = []
    make = Output.__init__

    def fails_once(output: Output, path: Path) -> None:
        if path.name == "bag_1.mcap" and not failed:
            failed.append(path)
            raise OSError(28, "No space left on device")
        make(output, path)

    monkeypatch.setattr(Output, "__init__", fails_once)
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS), Quiet())
    put(one, block, range(700))
    wait_for(lambda: one.state.messages == 700)
    assert one.close(180.0)
    assert failed
    assert sequences(tmp_path / "bag") == list(range(700))
    assert one.lost == {}


def test_a_removal_that_a_failed_write_shows_first_is_reported_as_a_removal(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_module, "LOOK", 1e9)  # it never looks by itself before the next part
    log = Quiet()
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, flush_interval=0.0), log)
    put(one, block, range(100))
    wait_for(lambda: one.state.messages == 100)
    shutil.rmtree(tmp_path / "bag")
    put(one, block, range(100, 700))
    wait_for(lambda: (tmp_path / "bag").exists() and one.state.paused == "" and one.state.waiting == 0)
    assert one.close(180.0)
    assert any("bag_0.mcap was removed while it was recorded" in said for said in log.said)
    kept = sequences(tmp_path / "bag")
    assert kept == list(range(700 - len(kept), 700))
    assert one.lost == {"removed files": 700 - len(kept)}


def test_a_recording_that_pauses_rests_between_its_tries(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    free, looks, turns, empty = [10**12], [0], [0], Recording._empty

    def look(_: Path) -> int:
        looks[0] += 1
        return free[0]

    def turn(recording: Recording) -> None:
        turns[0] += 1
        empty(recording)

    monkeypatch.setattr(recording_module, "_free", look)
    monkeypatch.setattr(recording_module, "RETRY", 0.05)
    monkeypatch.setattr(Recording, "_empty", turn)
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, 10**9), Quiet())
    free[0] = 10**6
    wait_for(lambda: "minimum_free_space" in one.state.paused)
    put(one, block, range(50))
    looks[0] = turns[0] = 0
    wait_for(lambda: looks[0] >= 5)
    assert turns[0] <= 3 * looks[0]  # it takes thousands where it does not rest
    free[0] = 10**12
    wait_for(lambda: one.state.paused == "")
    assert one.close(180.0)
    assert sequences(tmp_path / "bag") == list(range(50))


def test_old_parts_keep_what_they_tell_without_accelerations(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_module, "THINNING_LOOK", 0.0)
    monkeypatch.setattr(recording_module, "LOOK", 0.01)
    private, public = make_keys(tmp_path / "keys")
    log, sign = Quiet(), signer(str(private))
    settings = RecordingSettings(TEN_SECONDS, sign=sign, thin_after=1.0)  # recorded in 2023
    one = Recording(tmp_path / "bag", settings, log)
    for sequence in range(1100):
        one.put(message(block, sequence))
        if sequence % 100 == 0:
            received = START + sequence * STEP + 1
            one.put(Recorded("/valve_1/estimate", KIND, received, received, TEXT, latched=True))
    wait_for(lambda: sum("is thinned" in line for line in log.said) == 2)
    assert one.close(180.0)
    reader = BagReader(tmp_path / "bag")
    assert sequences(tmp_path / "bag") == list(range(1000, 1100))
    assert len(list(reader.records("/valve_1/estimate"))) == 11
    told = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text("utf-8"))[
        "rosbag2_bagfile_information"
    ]
    assert [file["message_count"] for file in told["files"]] == [5, 6, 102]
    found = verify(tmp_path / "bag", public)
    assert (found.wrong, found.signed) == ([], 3)
    assert found.notes[:1] == ["bag_0.mcap: the recorder thinned it: its accelerations were removed"]
    assert thin(tmp_path / "bag" / "bag_2.mcap", tmp_path / "forged.mcap") is not None
    (tmp_path / "forged.mcap").replace(tmp_path / "bag" / "bag_2.mcap")
    (line,) = verify(tmp_path / "bag", public).wrong
    assert line.startswith("bag_2.mcap: it was edited")


def test_a_slow_disk_holds_up_nobody_and_what_it_costs_is_stated(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, release = threading.Event(), threading.Event()
    flush = BagWriter.flush_if_due

    def slow(writer: BagWriter) -> None:
        held.set()
        release.wait(180.0)
        flush(writer)

    monkeypatch.setattr(BagWriter, "flush_if_due", slow)
    monkeypatch.setattr(recording_module, "LARGEST_QUEUE", 100_000)
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS), Quiet())
    assert held.wait(180.0)
    put(one, block, range(500))
    lost = one.state.lost
    assert 0 < lost < 500
    release.set()
    wait_for(lambda: one.state.unstated == 0 and one.state.waiting == 0)
    assert one.close(180.0)
    kept = sequences(tmp_path / "bag")
    assert len(kept) == 500 - lost
    told = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text("utf-8"))[
        "rosbag2_bagfile_information"
    ]
    assert told["custom_data"]["lost_messages"] == str(lost)


def test_a_folder_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no recording in parts"):
        verify(tmp_path)


@pytest.mark.parametrize("gone", range(1, TRIES + 1))
def test_a_recording_whose_parts_go_while_it_is_verified_is_looked_at_again(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch, gone: int
) -> None:
    """A part goes during each of the first looks; one that loses a part at every look is given up."""
    writer = recorded(tmp_path / "bag", block, 400, ONE_SECOND)
    left = [gone]

    def look(folder: Path, text: str | None, key: Path | None) -> Verification:
        if left[0]:
            left[0] -= 1
            writer.remove_oldest()
        return verify_once(folder, text, key)

    verify_once = verification._verify
    monkeypatch.setattr(verification, "_verify", look)
    if gone < TRIES:
        assert verify(tmp_path / "bag").wrong == []
    else:
        with pytest.raises(InputError, match="it changed while it was verified"):
            verify(tmp_path / "bag")
    writer.close()


def test_a_part_that_was_removed_before_a_restart_stays_named(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 1200, TEN_SECONDS).close()
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True).close()
    assert verify(tmp_path / "bag").wrong == ["part 0 was removed"]


def test_a_part_without_an_end_is_vouched_for_by_the_next_signature(tmp_path: Path, block: MakeBlock) -> None:
    private, public = make_keys(tmp_path / "keys")
    sign = signer(str(private))
    first = recorded(tmp_path / "bag", block, 100, TEN_SECONDS, sign=sign)
    first.flush()
    first.abandon()
    BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True, sign=sign).close()
    found = verify(tmp_path / "bag", public)
    assert (found.wrong, found.signed) == ([], 2)
    forged = BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True)  # by somebody without the key
    forged.write(forged.add_topic("/valve_1/text", KIND), START, TEXT)
    forged.flush()
    forged.abandon()
    (line,) = verify(tmp_path / "bag", public).wrong
    assert line.startswith("parts.sha256: it is not signed")


def test_one_recorder_writes_in_a_folder(tmp_path: Path, block: MakeBlock) -> None:
    first = recorded(tmp_path / "bag", block, 10, TEN_SECONDS)
    with pytest.raises(InputError, match="another recorder writes there"):
        BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True)
    first.close()
    BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True).close()


def test_a_part_that_cannot_be_read_keeps_nothing_from_going_on(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 700, TEN_SECONDS).close()
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    (tmp_path / "bag" / "bag_1.mcap").mkdir()  # it raises an OSError, as a bad sector does
    again = BagWriter(tmp_path / "bag", limits=TEN_SECONDS, resume=True)
    channel = again.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    again.write(channel, START + 700 * STEP, encode_block(block(700), "valve_1"))
    again.close()
    (wrong,) = verify(tmp_path / "bag").wrong
    assert wrong.startswith("bag_1.mcap: it cannot be read")
    assert sequences(tmp_path / "bag" / "bag_2.mcap") == [700]


def test_small_parts_hold_more_than_a_message(tmp_path: Path, block: MakeBlock) -> None:
    recorded(tmp_path / "bag", block, 8000, PartLimits(size=1_000_000)).close()
    sizes = [path.stat().st_size for path in tmp_path.glob("bag/*.mcap")]
    assert 1 < len(sizes) < 20
    assert max(sizes) <= 1_000_000


@pytest.mark.parametrize("where", ["_free", "_is_gone", "numbered"])
def test_whatever_call_fails_on_a_bad_disk_recording_goes_on_after_it(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    failing, real = [False], getattr(recording_module, where)

    def fails(path: Path) -> object:
        if failing[0]:
            raise OSError(5, "Input/output error")
        return real(path)

    monkeypatch.setattr(recording_module, where, fails)
    if where == "numbered":  # it is asked while there is no room only
        monkeypatch.setattr(recording_module, "_free", lambda _: 10 if failing[0] else 10**12)
    monkeypatch.setattr(recording_module, "RETRY", 0.01)
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, 1000, flush_interval=0.05), Quiet())
    put(one, block, range(100))
    wait_for(lambda: one.state.messages == 100)
    failing[0] = True
    wait_for(lambda: one.state.paused != "")
    put(one, block, range(100, 200))
    failing[0] = False
    wait_for(lambda: one.state.paused == "" and one.state.messages == 200)
    assert one.close(180.0)
    assert sequences(tmp_path / "bag") == list(range(200))
    assert one.lost == {}


def test_a_machine_that_is_switched_on_with_a_full_disk_records_once_there_is_room(
    tmp_path: Path, block: MakeBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(tmp_path / "bag", block, 100, TEN_SECONDS).close()
    full = [True]
    fill(monkeypatch, lambda: full[0])
    one = Recording(tmp_path / "bag", RecordingSettings(TEN_SECONDS, resume=True), Quiet())
    assert "No space left" in one.state.paused
    one.put(message(block, 100))
    full[0] = False
    wait_for(lambda: one.state.messages == 1)
    assert one.close(180.0)
    assert sequences(tmp_path / "bag") == list(range(101))


def test_a_clock_that_jumps_makes_no_part_old(tmp_path: Path, block: MakeBlock) -> None:
    """A year ahead between two parts: thinned data cannot be recovered."""
    writer = recorded(tmp_path / "bag", block, 600, TEN_SECONDS)
    year = 365 * 86_400 * 10**9
    channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
    for sequence in range(600, 1200):
        one = encode_block(block(sequence), "valve_1")
        writer.write(channel, START + year + sequence * STEP, one)
    assert len(writer.finished_parts) == 3
    assert older(writer, 30 * 86_400e9) == []
    assert len(older(writer, 1e9)) == 3
    writer.close()
