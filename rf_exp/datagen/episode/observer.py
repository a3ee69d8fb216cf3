"""Who looks on while an episode is made."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.planning import Planned
from rf_exp.findings import Violation
from rf_exp.types import Scene


class Observer(Protocol):
    """Looks on while an episode is made, e.g. to record it. Must not change anything."""

    def planned(self, plan: Planned) -> None: ...

    def rejected(self, violation: Violation) -> None: ...

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None: ...


class NullObserver:
    """The observer that looks away."""

    def planned(self, plan: Planned) -> None:
        pass

    def rejected(self, violation: Violation) -> None:
        pass

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        pass
