"""Keyframes from lines and from a watched folder."""

import base64
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocols.agent import folder_watch
from protocols.agent.folder_watch import FolderWatch
from protocols.agent.lines import Given, read_line


def line(**change: object) -> str:
    return json.dumps({"keyframe": 3, "descriptors": {"lidar": [0.6, 0.8]}, **change})


def test_a_line_is_read() -> None:
    given = read_line(line(payload=base64.b64encode(b"scan").decode(), stamp=1.5))
    assert (given.keyframe, given.payload, given.stamp) == (3, b"scan", 1.5)
    assert np.array_equal(given.descriptors["lidar"], [0.6, 0.8])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not JSON"),
        ("[1]", "a line is an object such as"),
        ("[" * 100_000, "not JSON"),
        (line(descriptor=1), "a line has no 'descriptor'; did you mean 'descriptors'"),
        ("{}", "a line needs keyframe"),
        (line(keyframe="3"), "an integer"),
        (line(descriptors=[0.6]), "keyframe 3: descriptors are an object"),
        (line(descriptors={"lidar": ["a"]}), "keyframe 3: the descriptor 'lidar' is not an array of numbers"),
        (line(descriptors={"lidar": [[1.0], [1.0, 2.0]]}), "keyframe 3: the descriptor 'lidar'"),
        (line(payload="%%"), "keyframe 3: its payload is not base64"),
        (line(payload=7), "keyframe 3: its payload is not base64"),
        (line(stamp="noon"), "keyframe 3: its stamp"),
        (line(stamp=float("nan")), "keyframe 3: its stamp"),
        (line(stamp=10**400), "keyframe 3: its stamp"),
    ],
)
def test_a_bad_line_is_refused_by_name(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_line(text)


class Watched:
    """A folder, what was taken from it and what was refused."""

    def __init__(self, folder: Path, descriptor: str | None = "lidar") -> None:
        self.taken: list[Given] = []
        self.refused: list[str] = []
        self.watch = FolderWatch(folder, descriptor, self.taken.append, self.refused.append)


def test_files_are_taken_once_and_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    np.savez(tmp_path / "10.npz", lidar=np.ones(2), payload=np.frombuffer(b"scan", np.uint8), stamp=2.5)
    np.save(tmp_path / "kf_9.npy", np.ones(2))
    (tmp_path / "more.jsonl").write_text(line() + "\n" + line(keyframe=4) + "\n")
    (tmp_path / "notes.txt").write_text("not ours")
    watched = Watched(tmp_path)
    watched.watch.look()
    watched.watch.look()
    assert [given.keyframe for given in watched.taken] == [3, 4, 9, 10]
    assert watched.taken[-1].payload == b"scan" and watched.taken[-1].stamp == 2.5
    assert not watched.refused


def test_a_half_written_file_is_read_when_it_is_whole(tmp_path: Path) -> None:
    np.savez(tmp_path / "whole", lidar=np.ones(64))
    octets = (tmp_path / "whole.npz").read_bytes()
    os.unlink(tmp_path / "whole.npz")
    watched, file = Watched(tmp_path), tmp_path / "7.npz"
    for size in range(0, len(octets), 37):
        file.write_bytes(octets[:size])
        watched.watch.look()
    assert not watched.taken and not watched.refused
    file.write_bytes(octets)
    watched.watch.look()
    assert [given.keyframe for given in watched.taken] == [7] and not watched.refused


def test_a_file_that_stays_unreadable_is_named_and_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_watch, "PATIENCE", 0.05)
    (tmp_path / "1.npz").write_bytes(b"PK half")
    np.save(tmp_path / "2.npy", np.ones(2))
    np.save(tmp_path / "noname.npy", np.ones(2))
    watched = Watched(tmp_path)
    watched.watch.look()
    time.sleep(0.1)
    watched.watch.look()
    assert [given.keyframe for given in watched.taken] == [2]
    assert ["1.npz" in watched.refused[1], "noname.npy" in watched.refused[0]] == [True, True]


def test_a_pickle_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_watch, "PATIENCE", 0.0)
    np.save(tmp_path / "1.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    watched = Watched(tmp_path)
    watched.watch.look()
    assert not watched.taken and "1.npy cannot be read and is tried again" in watched.refused[0]


def test_an_npy_file_needs_a_plan_with_one_descriptor(tmp_path: Path) -> None:
    np.save(tmp_path / "1.npy", np.ones(2))
    watched = Watched(tmp_path, None)
    watched.watch.look()
    assert watched.refused == [
        "1.npy is left out: the plan has several descriptors: write NUMBER.npz with an array for each"
    ]


@pytest.mark.parametrize("name", ["17_v2.npy", "1700000000.25.npy", "-1x.npy", "noname.npy"])
def test_a_name_that_could_be_misread_is_refused(tmp_path: Path, name: str) -> None:
    np.save(tmp_path / name, np.ones(2))
    watched = Watched(tmp_path)
    watched.watch.look()
    assert not watched.taken and f"{name} is left out: its name is not a number" in watched.refused[0]


def test_a_folder_that_is_not_there_yet_is_waited_for(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "later")
    assert watched.watch.look() == 0
    (tmp_path / "later").mkdir()
    np.save(tmp_path / "later" / "5.npy", np.ones(2))
    assert watched.watch.look() == 1


@pytest.mark.parametrize("stamp", [np.zeros(2), np.array("noon"), np.zeros(0)])
def test_a_file_whose_stamp_is_none_is_left_out_and_the_next_is_taken(
    tmp_path: Path, stamp: np.ndarray[Any, Any]
) -> None:
    np.savez(tmp_path / "1.npz", lidar=np.ones(2), stamp=stamp)
    np.savez(tmp_path / "2.npz", lidar=np.ones(2), stamp=np.array([2.5]))
    watched = Watched(tmp_path)
    watched.watch.look()
    assert [(given.keyframe, given.stamp) for given in watched.taken] == [(2, 2.5)]
    assert watched.refused == ["1.npz is left out: its stamp is not one number"]
