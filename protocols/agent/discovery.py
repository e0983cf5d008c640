"""Stand-in until the real one is merged."""

from collections.abc import Callable, Collection


class Discovery:
    """Finds nobody."""

    def __init__(
        self,
        mission: str,
        robot: str,
        port: int | None,
        peers: Collection[str],
        *,
        on_event: Callable[[str], None],
    ) -> None:
        pass

    def address_of(self, peer: str) -> str | None:
        """None."""
        return None

    def close(self) -> None:
        """Nothing."""
