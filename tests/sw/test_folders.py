"""Folders and files to write to: what is judged beforehand, and what is written whole."""

import os
import re
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from ukf_sw.folders import check_file, check_folder, locked, replacing

#: No file can have such a name.
LONG = "x" * 300


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def no_root(tmp_path):
    """A folder that may not be written to; root may write to any, so it is one that is no place."""
    if os.geteuid() == 0:
        return Path("/proc")
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    return folder


@pytest.mark.parametrize("name", ["there", "absent", "absent/below", "."])
def test_folder_that_will_do(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("there").mkdir()
    assert check_folder("--output", name) == Path(name)
    assert names(Path()) == ["there"]
    assert not names(Path("there"))


@pytest.mark.parametrize("name", ["new.png", "old.PNG", "absent/new.png"])
def test_file_that_will_do(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("old.PNG").write_text("old")
    assert check_file("--plot", name, (".png", ".svg")) == Path(name)
    assert names(Path()) == ["old.PNG"]
    assert Path("old.PNG").read_text() == "old"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "--output must be the name of a folder, not ''"),
        ("file", "--output must be a folder, not the file 'file'"),
        ("file/x", "--output must be a folder that can be written, not 'file/x' (Not a directory)"),
        ("dangling", "--output must be a folder, not the file 'dangling'"),
        (
            LONG,
            f"--output must be a folder that can be written, not {LONG!r} (File name too long)",
        ),
    ],
)  # fmt: skip
def test_folder_that_will_not_do(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    Path("dangling").symlink_to("absent")
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        check_folder("--output", name)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "--plot must be the name of a file, not ''"),
        (".", "--plot must be a file, not the folder '.'"),
        ("x.foo", "--plot must end with .png or .svg, not 'x.foo'"),
        (".png", "--plot must end with .png or .svg, not '.png'"),
        (
            "file/x.png",
            "--plot must be a file that can be written, not 'file/x.png' (Not a directory)",
        ),
    ],
)  # fmt: skip
def test_file_that_will_not_do(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        check_file("--plot", name, (".png", ".svg"))


def test_place_without_permission(no_root):
    with pytest.raises(ValueError, match=r"^--output must be a folder that can be written, not '"):
        check_folder("--output", no_root / "x")
    with pytest.raises(ValueError, match=r"^--plot must be a file that can be written, not '"):
        check_file("--plot", no_root / "x.png")


def test_file_is_replaced_whole_or_not_at_all(tmp_path):
    file = tmp_path / "file"
    file.write_text("old")
    with replacing(file) as part:
        part.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    other = tmp_path / "other"
    other.touch()
    assert file.stat().st_mode == other.stat().st_mode
    other.unlink()
    with pytest.raises(ZeroDivisionError), replacing(file) as part:
        part.write_text(f"half {1 // 0}")
    assert file.read_text() == "new"
    assert names(tmp_path) == ["file"]


def test_what_a_killed_process_leaves_is_removed_later(tmp_path):
    program = (
        "import os, sys; from pathlib import Path; from ukf_sw.folders import replacing\n"
        "with replacing(Path(sys.argv[1])) as part: part.write_text('half'); os._exit(1)"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "file")], check=False)
    (left,) = tmp_path.iterdir()
    for age, number in ((600.0, 2), (7200.0, 1)):
        os.utime(left, (time.time() - age,) * 2)
        with replacing(tmp_path / "file") as part:
            part.write_text("whole")
        assert len(names(tmp_path)) == number
    assert (tmp_path / "file").read_text() == "whole"


@pytest.mark.parametrize("name", [".", "lock"])
def test_one_at_a_time(tmp_path, name):
    inside = []

    def work():
        with locked(tmp_path / name):
            inside.append("in")
            time.sleep(0.02)
            inside.append("out")

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert inside == ["in", "out"] * 4


def test_systems_without_such_locks(tmp_path):
    program = (
        "import sys; sys.modules['fcntl'] = None\n"
        "from pathlib import Path; from ukf_sw.folders import locked\n"
        "with locked(Path(sys.argv[1])): print('in')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.stdout == "in\n"
