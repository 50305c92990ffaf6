"""What the searches have in common: sweepers of Hydra's whose jobs go on where they stopped, on any launcher."""

from __future__ import annotations

import sys
import types
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.multirun import plain_key
from ogmp_sb3.runs.run_directory import FAILURE, MULTIRUN

HOME = "hydra._internal.core_plugins.ogmp_sb3"  # Hydra takes plug-ins from its own packages alone
ANOTHER = "Choose another directory: hydra.sweep.dir=..."  # the end of a message
BUDGET = "total_timesteps"  # the key that a search sets for each of its rounds


class SearchSweeper(Sweeper):
    """A search over values of keys.

    :param params: values of keys, as on the command line, which goes before them
    """

    config: DictConfig
    launcher: Launcher
    hydra_context: HydraContext

    def __init__(self, params: Mapping[str, str]) -> None:
        self.params = params
        self.launched = 0

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """What Hydra hands over before the sweep."""
        sys.modules.pop(HOME, None)  # processes that a launcher starts do not find it: they get the class itself
        self.hydra_context, self.config = hydra_context, config
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def _overrides(self, arguments: Sequence[str], parser: OverridesParser) -> list[Override]:
        """The command line, and what the settings add to it."""
        command_line = parser.parse_overrides(list(arguments))
        typed = {plain_key(override.key_or_group) for override in command_line}
        params = [f"{key}={value}" for key, value in self.params.items() if plain_key(key) not in typed]
        return [*parser.parse_overrides(params), *command_line]

    def _total(self, overrides: Sequence[Override]) -> int:
        """Samples of a job that is trained to the end."""
        totals = [override for override in overrides if override.key_or_group == BUDGET]
        value = totals[-1].get_value_string() if totals and totals[-1].is_sweep_override() else self.config[BUDGET]
        return int(read(int, value, Where("ogmp-train", BUDGET)))

    def _folder(self) -> Path:
        """The directory of the search, with what it was started with; jobs of a plain sweep may be there.

        :raises ValueError: if another kind of search is
        """
        folder = Path(self.config.hydra.sweep.dir)
        file, target = folder / MULTIRUN, str(self.config.hydra.sweeper._target_)
        there = read_yaml(file).get("hydra", {}).get("sweeper", {}).get("_target_") if file.is_file() else target
        if there != target and str(there).startswith(HOME):
            names = [str(name).rpartition(".")[2] for name in (there, target)]
            raise ValueError(
                f"{folder}: holds a search by the {names[0]}, where this one is by the {names[1]}. {ANOTHER}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        OmegaConf.save(self.config, file)
        return folder

    def _launch(self, batch: Sequence[list[str]]) -> list[Path | None]:
        """Run jobs on the launcher.

        :param batch: command line of each
        :return: directory of each, None where it failed
        """
        self.validate_batch_is_legal(batch)
        results = self.launcher.launch(batch, initial_job_idx=self.launched)
        self.launched += len(batch)
        folders: list[Path | None] = []
        for result in results:
            _ = result.return_value  # raises what a job raised
            folder = Path(result.hydra_cfg.hydra.runtime.output_dir)  # type: ignore[union-attr]
            folders.append(None if (folder / FAILURE).is_file() else folder)
        return folders


def register_sweepers(sweepers: Mapping[str, tuple[type[SearchSweeper], Mapping[str, Any]]]) -> None:
    """Make searches known to Hydra.

    :param sweepers: class and settings of each, by the name that ``hydra/sweeper=`` takes
    """
    home = types.ModuleType(HOME)
    for name, (kind, settings) in sweepers.items():
        Plugins.instance().register(kind)
        setattr(home, kind.__name__, kind)
        node = {"_target_": f"{HOME}.{kind.__name__}", **settings, "params": {}}
        ConfigStore.instance().store(group="hydra/sweeper", name=name, node=node, provider="ogmp_sb3")
    sys.modules[HOME] = home
