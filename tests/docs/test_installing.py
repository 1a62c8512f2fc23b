"""Files that install relocbench agree with each other: pins, hashes, the image, the light requirements."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from repository import ROOT

PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^ ]+)", re.MULTILINE)


def pins(name: str) -> dict[str, str]:
    return dict(PIN.findall((ROOT / name).read_text()))


def requirement_names(lines: list[str]) -> set[str]:
    return {re.split(r"[\[<>=! ]", line.strip())[0] for line in lines if line.strip() and not line.startswith("#")}


def dependencies() -> list[str]:
    found: list[str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    return found


def test_hashes_are_those_of_the_pins() -> None:
    assert pins("constraints.txt") == pins("tools/hashes.txt")
    assert requirement_names(dependencies()) <= pins("constraints.txt").keys() | {"PyYAML"}


def test_every_pinned_package_has_a_hash_and_no_address() -> None:
    hashes = (ROOT / "tools" / "hashes.txt").read_text()
    blocks = re.split(r"\n(?=[A-Za-z0-9])", hashes)
    assert all("--hash=sha256:" in block for block in blocks if "==" in block)
    assert "://" not in hashes + (ROOT / "constraints.txt").read_text()


def test_set_up_installs_nothing_of_others_without_a_hash() -> None:
    commands = re.findall(r" pip install (.+)$", (ROOT / "tools" / "setup.sh").read_text(), re.MULTILINE)
    without = [command for command in commands if "--require-hashes" not in command.split()]
    assert len(commands) == 3
    assert without == ["--quiet --no-deps --no-build-isolation -e ."], "relocbench itself, with what is installed"


def test_images_actions_and_hooks_of_others_are_pinned_by_digest() -> None:
    unpinned = []
    pinned = {
        "Dockerfile": (r"^FROM (.+)$", r"\S+@sha256:[0-9a-f]{64}"),
        ".github/workflows/*.yml": (r"\buses: *(.+)$", r"\S+@[0-9a-f]{40} # v\d.*"),
        ".pre-commit-config.yaml": (r"\brev: *(.+)$", r"[0-9a-f]{40} # .*"),
    }
    for pattern, (named, digest) in pinned.items():
        found = [one for path in ROOT.glob(pattern) for one in re.findall(named, path.read_text(), re.MULTILINE)]
        assert found, pattern
        unpinned += [one for one in found if not re.fullmatch(digest, one)]
    assert unpinned == []


def test_the_light_installation_asks_for_the_same_versions() -> None:
    light = (ROOT / "requirements-light.txt").read_text().splitlines()
    assert {line for line in light if line and not line.startswith("#")} < set(dependencies())


def test_the_image_and_the_set_up_need_the_same_libraries() -> None:
    image, setup = (ROOT / "Dockerfile").read_text(), (ROOT / "tools" / "setup.sh").read_text()
    installed = re.search(r"--no-install-recommends ([^\\\n]+)", image)
    assert installed is not None
    libraries = set(re.findall(r"lib[\w.+-]*\.so\.\d+:([\w.-]+)", setup))
    assert set(installed[1].split()) == libraries
    assert libraries <= set((ROOT / ".github" / "workflows" / "ci.yml").read_text().split())


def test_the_image_gets_every_folder_that_the_wheel_needs() -> None:
    copied = {
        word
        for line in re.findall(r"^COPY (.+) \S+$", (ROOT / "Dockerfile").read_text(), re.M)
        for word in line.split()
    }
    admitted = set(re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(), re.M))
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert copied == admitted
    assert {*wheel["packages"], "pyproject.toml", "README.md", "LICENSE"} <= copied
    assert all((ROOT / name).exists() for name in copied)


def test_a_package_shows_the_readme_with_whole_addresses_of_files_that_exist() -> None:
    sys.path.insert(0, str(ROOT))
    from hatch_build import with_whole_addresses

    shown = with_whole_addresses((ROOT / "README.md").read_text(), "https://forge.example/project", "v9")
    targets = re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", shown)
    ours = [(bool(picture), to) for picture, to in targets if to.startswith("https://forge.example/project/")]
    assert any(picture for picture, _ in ours)
    for picture, to in ours:
        form, path = to.removeprefix("https://forge.example/project/").split("/v9/")
        assert form == ("raw" if picture else "blob")
        assert (ROOT / path.partition("#")[0]).exists(), path
    assert all(to.startswith("https://") for _, to in targets)


@pytest.mark.thorough
def test_the_wheel_holds_all_templates_and_fills_them_from_there(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    packages = (ROOT / "relocbench", ROOT / "baselines")
    templates = {str(path.relative_to(ROOT)) for folder in packages for path in folder.rglob("*.j2")}
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if name.endswith(".j2")} == templates
        archive.extractall(tmp_path / "installed")
    for place in (wheel, tmp_path / "installed"):  # a package in an archive has no folder
        code = (
            "from relocbench import pages; print(pages.__file__)\n"
            "print(pages.render('baselines.gn_net.training.loop', 'about.md.j2', name='n', parameters=1, "
            "network={'levels': 2, 'dim': 3}))"
        )
        filled = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(place)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        assert filled.startswith(f"{place}/relocbench/pages/__init__.py\nFeature network")
        assert "2 levels of 3 channels" in filled


@pytest.mark.parametrize("of_this_checkout", [True, False])
def test_set_up_refuses_the_environment_of_another_checkout(of_this_checkout: bool, tmp_path: Path) -> None:
    owner = ROOT if of_this_checkout else tmp_path / "other"
    (tmp_path / "other").mkdir()
    for version, checkout in (("0.1.0", owner), ("0.2.0", ROOT)):  # an interrupted installation leaves both
        installed = tmp_path / f"env/lib/python3.11/site-packages/relocbench-{version}.dist-info"
        installed.mkdir(parents=True)
        url = f'{{"url": "{checkout.as_uri()}", "dir_info": {{"editable": true}}}}'
        (installed / "direct_url.json").write_text(url)
    # Without a Python, set-up ends after the question whose environment it is.
    environment = os.environ | {"VENV": str(tmp_path / "env"), "PYTHON": "no-python"}
    done = subprocess.run([ROOT / "tools" / "setup.sh"], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert (str(owner) in done.stderr) == (not of_this_checkout)
