"""What a compute unit knows of a drone: all that it may fly, and of which of that the contents."""

from __future__ import annotations

from typing import NamedTuple

from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory


class SeparationGuarantee(NamedTuple):
    """What a plan of unknown contents has kept, since its author avoided what others then flew."""

    round: int
    """When it was planned: it keeps clear of all that was flown then, at separating planes."""
    parents: tuple[Trajectory, ...]
    """What the drone may have flown then, one of which gave the planes."""


class InformationTracker:
    """Candidates of one drone at one compute unit (D_iw).

    `covering`: the candidates contain the true one (Lemma 1). `sole`: and there is no other.
    `up_to_date`: and all units of the view that are up to date hold the same (Lemma 2).
    """

    def __init__(self) -> None:
        self.possible: set[Identity] = set()
        """What the drone may fly now or from the next round on."""
        self.located = False
        """Whether the drone has been heard, locked to the unit's view, since that was adopted."""
        self.confirmed = -1
        """Round of the last message from the drone that counted."""
        self._contents: dict[Identity, Trajectory] = {}
        self._guarantees: dict[Identity, SeparationGuarantee] = {}

    @property
    def covering(self) -> bool:
        """Whether the true trajectory is among the candidates (Lemma 1)."""
        return self.located and all(one in self._contents for one in self.possible)

    @property
    def sole(self) -> Trajectory | None:
        """The one trajectory that the drone can fly, if that is known."""
        if not self.located or len(self.possible) != 1:
            return None
        (only,) = self.possible
        return self._contents.get(only)

    def up_to_date(self, round_: int) -> bool:
        """Whether the drone was heard in the last round and nothing is missing."""
        return self.confirmed == round_ - 1 and self.covering

    @property
    def candidates(self) -> list[Trajectory]:
        """Those of known contents."""
        return [self._contents[one] for one in sorted(self.possible) if one in self._contents]

    @property
    def missing(self) -> list[Identity]:
        """Those of unknown contents."""
        return [one for one in sorted(self.possible) if one not in self._contents]

    def newest(self) -> Trajectory | None:
        """The candidate with the latest start."""
        known = [one for one in self.possible if one in self._contents]
        return self._contents[max(known)] if known else None

    def settled(self, round_: int) -> Trajectory | None:
        """The newest candidate, if by the next round the drone will have said what it flies.

        That is so if nothing is missing, and there is one, or one more was sent in the last round.
        """
        if not self.covering or sum(one.start_round < round_ for one in self.possible) > 1:
            return None
        return self.newest()

    def guarantee(self, identity: Identity) -> SeparationGuarantee | None:
        """What is known of a plan of unknown contents."""
        return self._guarantees.get(identity)

    def lose(self) -> None:
        """Know no longer what the drone may fly."""
        self.located, self.confirmed = False, -1

    def locate(self, identity: Identity, round_: int, at_rest: Trajectory | None) -> None:
        """The drone, locked to the view, says what it flies in a round; at rest that is all of it.

        Whatever else it could have flown by then it does not fly.
        """
        later = {one for one in self.possible if one.start_round > round_}
        self.possible = later | {identity} if self.located else {identity}
        self.located, self.confirmed = True, round_
        if at_rest is not None:
            self._contents.setdefault(identity, at_rest)
        kept = self.possible | set(self._newest_contents())
        self._contents = {key: one for key, one in self._contents.items() if key in kept}
        self._guarantees = {key: p for key, p in self._guarantees.items() if key in self.possible}

    def add(self, identity: Identity, contents: Trajectory | None) -> None:
        """A plan was sent to the drone, or may have been if its contents are not given."""
        planned = identity.start_round - 1
        if contents is not None:
            self._contents[identity] = contents
        elif self.located and all(one.start_round > planned for one in self.missing):
            parents = tuple(c for c in self.candidates if c.identity.start_round <= planned)
            self._guarantees.setdefault(identity, SeparationGuarantee(planned, parents))
        self.possible.add(identity)

    def learn(self, contents: Trajectory) -> None:
        """Remember a trajectory of the drone, whether it may be flown or not."""
        self._contents[contents.identity] = contents

    def contents(self, identity: Identity) -> Trajectory | None:
        """A trajectory, if it is still remembered."""
        return self._contents.get(identity)

    def strike(self, identity: Identity) -> None:
        """The drone was sent no such plan."""
        self.possible.discard(identity)

    def _newest_contents(self) -> list[Identity]:
        """Kept for a while even where the drone flies something else: others may ask for them."""
        return sorted(self._contents)[-3:]
