"""Known vulnerabilities of the installed packages, by pip-audit, and how many packages it knew nothing about.

    python .ci/audit.py <pip-audit>

pip-audit passes over what its service does not know and ends well all the same, so that behind a mirror of PyPI without
vulnerability data it would pass everything. This says what was looked at. It fails for a vulnerability, never for want
of a network.
"""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any


def verdict(report: dict[str, Any]) -> tuple[str, bool]:
    """What a report of pip-audit comes to, and whether it is fine.

    :param report: what ``pip-audit --format json`` prints
    """
    packages = report["dependencies"]
    known = [package for package in packages if "skip_reason" not in package]
    found = [f"{p['name']} {p['version']}: {v['id']}" for p in known for v in p["vulns"]]
    if found:
        return "vulnerable: " + ", ".join(found), False
    if not known:
        return f"no vulnerability service here knows any of the {len(packages)} packages: NOT audited", True
    return f"{len(known)} of {len(packages)} packages audited, no known vulnerability", True


def main() -> int:
    """Entry point."""
    tool = Path(sys.argv[1])
    if not tool.is_file():
        print("audit: pip-audit could not be installed: NOT audited")
        return 0
    command = [str(tool), "--format", "json", "--progress-spinner", "off", "--path", sysconfig.get_paths()["purelib"]]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        text, fine = verdict(json.loads(done.stdout))
    except (subprocess.TimeoutExpired, ValueError):
        text, fine = "no vulnerability service answers here: NOT audited", True
    print(f"audit: {text}")
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
