"""Strain tables that a trial of an arm goes through.

They are tensions alone, POD modes, Legendre moments and forces, explicit strain.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Any

from soft_tendon_env.model.coordinates import coordinate_count
from soft_tendon_env.model.reference_model import part_borders
from soft_tendon_env.scene.passive_fields import PassiveFields, fields_of, find_fields
from soft_tendon_env.scene.scene import Scene, breakpoints
from soft_tendon_env.scene.strain import STRAINS, Snapshots, StaticsBased
from soft_tendon_env.tools.configuration import ConfigurationError

FIELDS = (6, 9, 12, 18, 24)
"""Numbers of the arm's own POD modes that are tried."""

ROD_ORDERS = (1, 2, 3, 4, 6, 8, 10, 12)
"""Legendre orders of moments over the whole rod that are tried."""

PART_ORDERS = (1, 2, 3, 4, 5, 6, 7, 9)
"""Legendre orders of moments over each part of the rod that are tried."""

EXPLICIT_ORDERS = (4, 6, 9)
"""Legendre orders of explicit strain over each part that are tried."""

ANGULAR = STRAINS[:3]
"""Torsion and bending, the strains that most arms are soft in."""


def bare_rod(scene: Scene) -> dict[str, Any]:
    """Strain table of the rod alone, without what is a matter of accuracy."""
    if isinstance(scene.strain, StaticsBased):
        kept = {"type", "strains", "borders", "rank_tolerance", "include_loads"}
        return scene.strain.model_dump(mode="json", include=kept)
    free = [strain for strain in STRAINS if strain in scene.strain.free]
    return {"type": "statics_based", "strains": free, "borders": list(scene.strain.borders)}


def known_fields(scene: Scene) -> PassiveFields | None:
    """Passive fields of the arm, the best for its loads first.

    They are those of the file that its scene names, or those that ship or are kept.
    """
    named = None
    if isinstance(scene.strain, StaticsBased):
        named = scene.strain.passive
    if isinstance(named, Snapshots):
        return fields_of(scene)
    return find_fields(scene.replace({"strain": bare_rod(scene)}))


def snapshots(scene: Scene, fields: PassiveFields, count: int) -> dict[str, Any]:
    """Strain table with this many of the passive fields."""
    rod = bare_rod(scene)
    if not count:
        return {**rod, "passive": []}
    table = {"type": "snapshots", "fields": count, "digest": fields.digest}
    file = getattr(getattr(scene.strain, "passive", None), "file", None)
    if file:
        table["file"] = file
    return {**rod, "passive": table}


def strain_tables(
    scene: Scene, fields: PassiveFields | None, least: int = 0
) -> Iterator[dict[str, Any]]:
    """Strain tables with `least` coordinates or more that a trial goes through, fewest first.

    A table is counted only when its turn may come, since that takes as long as to judge it: it has
    at least as many coordinates as fields, and more by the tensions that no field makes.
    """
    tables = list(_every_table(scene, fields))
    waiting = []
    for place, table in enumerate(tables):
        bound = least_count(scene, table)
        waiting.append((bound, False, place))
    heapq.heapify(waiting)  # by counts, bounds before exact ones

    while waiting:
        bound, is_exact, place = heapq.heappop(waiting)
        table = tables[place]
        if is_exact:
            if bound >= least:
                yield table
            continue
        changed = scene.replace({"strain": table})
        try:
            count = coordinate_count(changed)
        except ConfigurationError:  # no independent coordinates
            continue
        if count:
            exact = max(count, bound)
            heapq.heappush(waiting, (exact, True, place))


def least_count(scene: Scene, strain: dict[str, Any]) -> int:
    """Number of Legendre fields of a strain table, which coordinates cannot be fewer than."""
    modes = strain.get("modes", strain.get("passive", []))
    if isinstance(modes, dict):
        return 0  # POD modes may depend on tensions
    changed = scene.replace({"strain": strain})
    pieces = breakpoints(changed).size - 1
    count = 0
    for mode in modes:
        if mode["span"] == "piece":
            spans = pieces
        else:
            spans = 1
        strain_count = len(mode["strains"])
        functions = mode["order"] + 1
        count += spans * strain_count * functions
    return count


def _every_table(scene: Scene, fields: PassiveFields | None) -> Iterator[dict[str, Any]]:
    rod = bare_rod(scene)
    free = list(scene.strain.free)
    borders = [*rod["borders"], *part_borders(scene)]
    in_parts = {"borders": borders}

    yield rod | {"passive": []}
    if fields is not None:
        for count in FIELDS:
            if count <= len(fields.coefficients):
                yield snapshots(scene, fields, count)

    # moments of the soft strains, then of all, that is with forces
    angular = [strain for strain in ANGULAR if strain in free]
    kinds = [free]
    if angular and angular != free:
        kinds = [angular, free]
    orders = _part_orders(scene, rod | in_parts)
    for strains in kinds:
        for order in ROD_ORDERS:
            moments = {"strains": strains, "order": order, "span": "rod"}
            yield rod | {"passive": [moments]}
        for order in orders:
            moments = {"strains": strains, "order": order, "span": "piece"}
            yield rod | {"passive": [moments]} | in_parts

    # strain that no law ties to the tensions
    for order in EXPLICIT_ORDERS:
        modes = {"strains": free, "order": order, "span": "piece"}
        yield {"type": "explicit", "modes": [modes]} | in_parts


def _part_orders(scene: Scene, strain: dict[str, Any]) -> list[int]:
    """Legendre orders over each part of a strain table's rod that are not tried over the rod."""
    changed = scene.replace({"strain": strain})
    is_one_part = breakpoints(changed).size == 2
    orders = []
    for order in PART_ORDERS:
        # on one part these are the same fields
        if not is_one_part or order not in ROD_ORDERS:
            orders.append(order)
    return orders
