"""Small sizes of the benchmarks: constants and arguments with which each does little of its work.

The constants of a benchmark set its size and its aims. Here some are replaced, and aims of time become bounds that
every machine meets. All together take some ten minutes of one core.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dpcontrol.bench import measure
from dpcontrol.bench.run import less_accurate
from dpcontrol.control.estimator_settings import AdaptiveEkfSettings
from dpcontrol.runs import preflight
from dpcontrol.runs.preflight import Hazard, PreflightSettings


@dataclass(frozen=True)
class Small:
    """The small size of a benchmark.

    Fixtures of a module are made once for all its small sizes, so constants that they use must be the same in all.

    module: file of the benchmark below tests, without .py.
    constants: values of constants of the module.
    arguments: values of parameters of the function, or of fixtures.
    environment: environment variables.
    parameter: parameter of a fixture that has several.
    prints: parts of what the benchmark prints; without any, it must print nothing.
    """

    module: str
    function: str
    constants: Mapping[str, Any] = field(default_factory=dict)
    arguments: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)
    parameter: Any = None
    prints: tuple[str, ...] = ()

    def __str__(self) -> str:
        values = [str(value) for value in self.arguments.values() if isinstance(value, (str, int, float))]
        return "-".join([self.module.rpartition("/")[2], self.function, *values])


NEVER = math.inf
"""Bound on a time that every machine meets."""

hazards, timed_in_turns = preflight.hazards, measure.timed_in_turns


def only_lag(*arguments: Any, **more: Any) -> list[Hazard]:
    """Return one hazard of a preflight instead of ten."""
    return [one for one in hazards(*arguments, **more) if one.setting == "lag"]


def once(functions: Mapping[Any, Any], *_: Any, **more: Any) -> Any:
    """Time each function by one call."""
    return timed_in_turns(functions, 1, **{**more, "grain": 0.0, "most": 0.0, "least": 1})


TURN = """
model = "lab"
energy = -0.07
walk = ["down-up +"]
start = "rest"
finish = "rest"
"""
THERE_AND_BACK = """
model = "lab"
energy = -0.07
walk = ["down-up +", "down-up -"]
wraps = [2]
"""

SIZES = [
    Small(
        "benchmarks/test_walk_cost",
        "test_cost_grows_with_the_number_of_symbols_and_no_faster",
        {"LENGTHS": (2, 4), "LONGEST": 8, "WALKS": 1, "PER_DOUBLING": NEVER},
        prints=("symbols  s ",),
    ),
    Small(
        "benchmarks/test_walk_cost",
        "test_all_random_walks_become_the_requested_orbits",
        arguments={"count": 6, "lengths": (1, 4), "periodic": False},
        prints=("\n6 walks: 0 complaints",),
    ),
    Small(
        "benchmarks/test_walk_cost",
        "test_all_random_walks_become_the_requested_orbits",
        arguments={"count": 2, "lengths": (1, 3), "periodic": True},
        prints=("\n2 closed walks: 0 complaints",),
    ),
    Small(
        "benchmarks/test_tube_speed",
        "test_tube_trajectories_are_150_times_faster_than_dop853_and_nearer_to_the_truth",
        {"COUNT": 40, "ROUNDS": 2, "EXAMINED": 4, "FASTER": 0},
        prints=("\n40 trajectories at 0.2 J", "\ndpcontrol "),
    ),
    Small(
        "benchmarks/test_estimators",
        "test_time_of_a_tick_by_kind_and_extras",
        {"EXTRAS": [()], "FASTER": 0.0, "TOGETHER": 0.0},
        prints=("ekf", "ukf"),
    ),
    Small(
        "benchmarks/test_estimators",
        "test_ten_minutes_leave_the_covariance_positive",
        {"TICKS": 20_000},
        {"start": (math.pi, math.pi, 0, 0, 0, 0), "augment": ("zeros",)},
        prints=("\nleast eigenvalue of the correlations ",),
    ),
    Small(
        "benchmarks/test_estimators",
        "test_consistency_by_extras_and_by_resolution",
        {"EXTRAS": [("zeros",)], "RUNS": 40, "COUNTS": (4000,)},
        prints=("NEES 0.9", "\n   4000 "),
    ),
    Small("benchmarks/test_killed_runs", "test_killed_runs_lose_no_more_than_twenty_five_milliseconds", {"KILLS": 1}),
    Small("benchmarks/test_logging", "test_fifty_kills_leave_fifty_readable_logs", {"KILLS": 2}),
    Small("benchmarks/test_logging", "test_five_hundred_corruptions_are_detected_or_recovered", {"CORRUPTIONS": 12}),
    Small(
        "benchmarks/test_logging",
        "test_the_log_takes_less_than_two_fifths_of_a_run",
        {"TURNS": 1, "SHARE": NEVER},
    ),
    Small(
        "benchmarks/test_logging",
        "test_a_ten_minute_log_is_scored_and_reviewed_in_seconds_and_within_a_gigabyte",
        {"TEN_MINUTES": 5000, "VERBS": {"score": NEVER}},
        {"verb": "score"},
    ),
    Small(
        "benchmarks/test_logging",
        "test_a_ten_minute_log_is_scored_and_reviewed_in_seconds_and_within_a_gigabyte",
        {"TEN_MINUTES": 5000, "VERBS": {"review": NEVER}},
        {"verb": "review"},
    ),
    Small(
        "benchmarks/test_against_rockit",
        "test_rockit_finds_the_same_cost_and_states",
        {"INTERVALS": (20, 80), "SAME_COST": 7e-3, "SAME_STATES": 7e-4},
        prints=("\n20 intervals: rockit's cost ", "\n80 intervals: rockit's cost "),
    ),
    Small(
        "benchmarks/test_basin_of_calming",
        "test_two_hundred_falls_are_calmed",
        {"SEEDS": (70_001, 70_007, 70_008, 70_010, 70_014, 70_029, 70_032, 70_053), "SECONDS": 4.0},
        prints=("\n8 of 8 at rest",),
    ),
    Small(
        "benchmarks/test_campaign_speed",
        "test_lockstep_is_three_hundred_times_quicker_than_time",
        {"RUNS": 4, "TRIES": 1, "PACE": 0},
        prints=("\nlockstep ",),
    ),
    Small(
        "benchmarks/test_catching",
        "test_two_blows_are_recovered_from",
        {"BLOWN": range(70_000, 70_002)},
        {"name": "outer-turn", "impulse": 0.01},
        prints=("\nouter-turn, 0.01 N m s: 2 completed",),
    ),
    Small(
        "benchmarks/test_catching",
        "test_catching_spares_falls",
        {"ITINERARY": "outer-turn", "SEEDS": (40_001,), "SECONDS": 15, "SPARED": 0},
        prints=("\n0.25 minutes, catching True: ", "\ncost to go from 300: "),
    ),
    Small(
        "benchmarks/test_encoders_and_clocks",
        "test_ordinary_encoders_complete_98_runs_of_100_and_no_scale_is_called_stuck",
        {"ITINERARIES": ("turn-from-rest",), "RUNS": 4, "SCALES": (2e-5,), "ENCODERS": (4000,)},
        {"rate": 1000.0},
        prints=("4 of 4",),
    ),
    Small(
        "benchmarks/test_friction_grid",
        "test_runs_with_dry_friction_complete",
        {"ITINERARIES": ("turn-from-rest",), "RUNS": 8, "SMOOTHINGS": (0.05,)},
        {"torque": 1e-3},
        prints=("1.0 mN m 0.050 rad/s told       8 of 8", "untold     8 of 8"),
    ),
    Small(
        "benchmarks/test_encoders_and_clocks",
        "test_readings_that_vary_in_age_by_up_to_a_period_complete",
        {"ITINERARIES": ("turn-from-rest",), "JITTERED_RUNS": 4, "JITTER_SHARES": {0.5: 0.97}},
        {"rate": 1000.0, "counts": 40_000},
        prints=("4 of 4",),
    ),
    Small(
        "benchmarks/test_encoders_and_clocks",
        "test_a_stuck_scale_is_found_soon_after_the_cart_has_moved_a_millimetre",
        {"ITINERARIES": ("turn-from-rest",), "STUCK": range(3)},
        {"scale": 2e-5, "share": 0.9},
        prints=("\n20 µm: ", "of 3 within 50 ms"),
    ),
    Small(
        "benchmarks/test_against_hiten",
        "test_a_connection_is_found_faster_than_by_hiten_and_closed_a_million_times_better",
    ),
    Small(
        "benchmarks/test_chart_ratios",
        "test_defaults_are_on_their_fronts_and_as_fast_and_accurate_as_before",
        {
            "losses": less_accurate,
            "complaints": lambda chart: (),
            "dpcontrol.bench.measure.timed_in_turns": once,
            "dpcontrol.bench.design.timed_in_turns": once,
        },
        {"name": "propagation"},
        prints=("\npropagation: ",),
    ),
    Small(
        "benchmarks/test_energy_sweep",
        "test_no_count_changes_without_a_located_cause",
        {"LOWEST": -0.1425, "HIGHEST": -0.1415, "ENERGIES": 2, "CHANGES": {("lab", "down-up", "down-up"): (0, 4)}},
        {"model": "lab", "source": "down-up", "target": "down-up"},
        prints=("saddle-node", "0 to 4  moves ", "  counts 0 4\n"),
    ),
    Small(
        "benchmarks/test_exported_library",
        "test_runs_by_the_library_end_as_runs_by_the_loop",
        {
            "ITINERARIES": ("outer-turn",),
            "SEEDS": range(1),
            "dpcontrol.control.export._measured": lambda files: (None, None),
        },
        environment={"CFLAGS": "-std=c99 -O0 -ffp-contract=off"},
    ),
    Small(
        "benchmarks/test_exported_tick",
        "test_a_tick_takes_microseconds",
        {"MEDIANS": {"tvlqr": NEVER}, "dpcontrol.control.export._measured": lambda files: (None, None)},
        {"law": "tvlqr", "single": False, "compiler": "gcc"},
    ),
    Small(
        "benchmarks/test_first_estimates",
        "test_the_first_estimates_come_near_to_the_best_possible",
        # The worst of a few runs is farther from the best possible than that of a hundred.
        {"RUNS": 3, "NEAR": 5.0},
        {"name": "outer-turn"},
        prints=("\nouter-turn: all within 25 mrad", "the filter", "as the filter knows them"),
    ),
    Small(
        "benchmarks/test_five_thousand_verdicts",
        "test_all_verdicts_on_five_thousand_drawn_runs_are_true",
        {"RUNS": 4, "SEEDS": 4, "BENCHES": 1},
        prints=("\n4 runs, ",),
    ),
    Small(
        "benchmarks/test_generated_scenes",
        "test_generated_scenes_are_planned_and_completed",
        environment={"DPCONTROL_SCENES_COUNT": "1", "DPCONTROL_SCENES_FIRST": "0", "DPCONTROL_SCENES_RUNS": "1"},
        prints=("| all |  | 1 | 1 | 1 of 1, 100.0 % |",),
    ),
    Small(
        "benchmarks/test_live_view",
        "test_a_live_view_makes_no_tick_late",
        # In five seconds on a busy machine, the viewer may receive nothing.
        {"ITINERARY": "outer-turn", "TURNS": 1, "SHOWN": 0, "SLOWER": NEVER},
        prints=("\nwithout a live view: ", "\nwith a live view: "),
    ),
    Small(
        "benchmarks/test_loop_speed",
        "test_the_loop_is_sixty_times_quicker_than_time_and_twenty_five_with_its_log",
        {"TRIES": 1, "PACE": 0.0, "PACE_WITH_LOG": 0.0},
        prints=("\nonce ", "with its log"),
    ),
    Small(
        "benchmarks/test_loop_speed",
        "test_sixty_four_runs_together_are_seven_hundred_times_quicker_than_time",
        {"TRIES": 1, "TOGETHER": 4, "PACE_TOGETHER": 0.0},
        prints=("\n4 runs: ",),
    ),
    Small(
        "benchmarks/test_loop_speed",
        "test_a_tick_takes_a_hundredth_of_its_period_and_the_first_no_longer",
        {"MEDIAN": NEVER, "NEARLY_ALL": NEVER},
        {"law": "tvlqr", "augment": ("zeros",)},
        prints=("\ntvlqr, zeros: ",),
    ),
    Small(
        "benchmarks/test_loop_speed",
        "test_a_tick_of_three_arms_takes_at_most_twice_that_of_two",
        {
            "TRIES": 1,
            "THIRD_ARM": NEVER,
            "TWO_ARMS": 'model = "lab"\nstart = "hold"\nhold = "down-up"\nseconds = 0.5\n',
            "THREE_ARMS": 'model = "triple"\nstart = "hold"\nhold = "down-down-up"\nseconds = 0.5\n',
        },
        prints=("\ntwo arms ", "three "),
    ),
    Small(
        "benchmarks/test_mechanics",
        "test_a_belt_of_30_hz_and_a_play_of_10_mrad_are_tolerated",
        {"RUNS": 2},
        {"name": "turn-from-rest", "kind": "belt"},
        prints=("{'belt': 30.0}: 2 of 2\n",),
    ),
    Small(
        "benchmarks/test_mechanics",
        "test_the_limits_of_the_guide_are_printed_and_those_of_the_belt_drawn",
        {
            "LADDER_RUNS": 2,
            "LADDERS": {"belt, known (Hz)": ({"belt": 30.0},)},
            "ITINERARIES": ("turn-from-rest",),
        },
        prints=("\nbelt, known (Hz) ", "100%", "belt.png"),
    ),
    Small(
        "benchmarks/test_polished_effort",
        "test_a_polished_plan_costs_no_more_than_a_tenth_above_an_independent_optimum",
        {"STEP": 0.02, "RUNS": 2, "WORKERS": 1, "SCENES": {"turn": TURN}},
        {"name": "turn"},
        prints=("\nturn: robust ", "polished", " times; [{0.05: Share(successes=2, runs=2"),
    ),
    Small(
        "benchmarks/test_preflight_against_campaigns",
        "test_the_rate_of_a_campaign_lies_in_the_interval",
        {
            "RUNS": 4,
            "SIZE": PreflightSettings(runs=16, workers=1),
            "PROCESSOR_SECONDS": NEVER,
            "dpcontrol.runs.preflight.hazards": only_lag,
        },
        {"name": "outer-turn"},
        prints=("\nouter-turn: ", "% of 4, in"),
    ),
    Small(
        "benchmarks/test_preflight_against_campaigns",
        "test_borders_are_those_of_a_finer_campaign",
        {
            "RUNS": 4,
            "FINER_RUNS": 4,
            "NEAR": 4.0,
            "RATIOS": np.array([0.25, 1.0, 4.0]),
            "SIZE": PreflightSettings(runs=16, workers=1),
            "dpcontrol.runs.preflight.hazards": only_lag,
        },
        {"name": "outer-turn"},
        prints=("\nouter-turn, lag: ", ", finer "),
    ),
    Small(
        "benchmarks/test_real_time_bench",
        "test_a_minute_at_a_kilohertz_completes_and_its_missed_deadlines_are_counted",
        {"LONG_WALK": THERE_AND_BACK, "TICKS": 3000},
    ),
    Small(
        "benchmarks/test_reference_edges",
        "test_the_edges_of_references",
        {
            "NAMES": ("outer-turn",),
            "FRICTION": (0.0, 1.0),
            "SHARES": {"position": (1.5, 0.02), "acceleration": (0.15,)},
        },
        prints=("\nouter-turn, friction\n", "outer-turn, position, taken without limits: ", "none\n"),
    ),
    Small(
        "benchmarks/test_references",
        "test_work_and_precision_of_methods_intervals_and_solvers",
        {"METHODS": [("radau-7", 0.03), ("lobatto-7", 0.03)]},
        {"symbols": 1},
        prints=("\nradau-7 ", "fatrop", "\nlobatto-7 "),
    ),
    Small(
        "benchmarks/test_references",
        "test_cost_grows_with_length_and_no_faster",
        {"LENGTHS": (1, 2), "TIGHT": 1e-7, "SECONDS_PER_SECOND": NEVER, "PER_DOUBLING": NEVER},
        prints=("\nsymbols  s ", "\n      2  "),
    ),
    Small(
        "benchmarks/test_references",
        "test_two_hundred_random_itineraries_all_converge",
        {"ITINERARIES": 2, "LONGEST": 2},
        prints=("\n2 itineraries: 0 complaints",),
    ),
    Small("benchmarks/test_replanning", "test_the_arms_of_a_seed_are_those_that_its_run_draws"),
    Small(
        "benchmarks/test_replanning",
        "test_a_plan_for_the_true_arms_completes_more",
        {"MISMATCHES": (0.3,), "RUNS": 2, "FAILED": 1, "COMPLETED": 1},
        {"name": "outer-turn"},
        prints=('"scene": "outer-turn"', '"between_runs": '),
    ),
    Small(
        "benchmarks/test_same_outcomes",
        "test_rounding_encoders_change_the_outcome_of_one_seed_in_a_hundred_at_most",
        {"SEEDS": 2},
        {"name": "as it should be"},
        prints=("symbols_completed the same for 2 of 2 seeds\n",),
    ),
    Small(
        "benchmarks/test_success_table",
        "test_the_default_controller_completes_a_shipped_itinerary",
        {"RUNS": 4, "BARS": {0.05: 0.5}},
        {"name": "outer-turn"},
        prints=("\n| outer-turn | 100.0 % (51.0) |\n",),
    ),
    Small(
        "benchmarks/test_success_table",
        "test_the_default_controller_tolerates_trouble",
        {"TROUBLED": ("outer-turn",), "TROUBLED_RUNS": 2},
        {"trouble": "20 ms of lag, known"},
        prints=("\n| 20 ms of lag, known | 100.0 % |\n",),
    ),
    Small(
        "benchmarks/test_ten_thousand_endings",
        "test_ninety_nine_percent_of_ten_thousand_endings_are_true",
        {"MOVING": ("outer-turn",), "SHARES": (1.0,), "COUNT": 2, "TOGETHER": 4, "FAULTY": 1},
        prints=(" failing runs of ", " true of "),
    ),
    Small(
        "benchmarks/test_ten_thousand_endings",
        "test_in_fifty_thousand_runs_without_a_fault_no_sensor_is_called_stuck",
        {"MOVING": ("outer-turn",), "SHARES": (1.0,), "SOUND": 4, "TOGETHER": 4, "FAULTY": 1},
        prints=("runs whose sensors work, 0 called stuck\n",),
    ),
    Small(
        "benchmarks/test_thorough_searches",
        "test_a_thorough_search_finds_what_brute_force_finds",
        {"POINTS": 2000, "SECONDS": NEVER},
        {
            "lengths": (0.2, 0.1),
            "masses": (0.1, 0.1),
            "saddles": ("up-down", "up-down"),
            "energy": 0.250155,
            "least": 32,
        },
    ),
    Small(
        "benchmarks/test_weights_of_the_default",
        "test_no_weights_are_both_quieter_and_safer_than_the_default_by_much",
        {
            "FACTORS": (1.0, 4.0),
            "FIRST": (AdaptiveEkfSettings().model_error,),
            "FAR_OFF": ("outer-turn",),
            "QUIET": 2,
            "RUNS": 2,
        },
        prints=('"factor": 1.0', '"factor": 4.0'),
    ),
    Small(
        "fuzz/test_fuzz",
        "test_many_damaged_files_are_read_or_refused_with_a_message",
        {"MORE": 1, "FILES": 3},
        {"kind": "scene"},
    ),
    Small(
        "fuzz/test_fuzz",
        "test_an_hour_of_hostile_inputs_causes_no_traceback_hang_or_leftover",
        environment={"DPCONTROL_FUZZ_MINUTES": "0.05"},
        prints=("seed ", "in all: {'inputs': "),
    ),
    Small("walks/test_random_walks", "test_random_walks_give_the_requested_orbits", {"WALKS": 2}),
    Small(
        "identification/test_identification",
        "test_true_ratios_and_zeros_lie_inside_the_95_percent_region",
        {"RUNS": 1, "COVERED": 0.8},
    ),
    Small(
        "bifurcations/test_bifurcations",
        "test_nearly_tangent_cuts_give_every_crossing_above_a_tenth_of_a_microjoule",
        arguments={"name": (-0.1425, -0.1415), "which": 0, "kind": "saddle-node"},
    ),
    Small(
        "bifurcations/test_bifurcations",
        "test_energies_are_independent_of_sampling_and_seed_distance",
        arguments={"name": (-0.1425, -0.1415)},
    ),
    Small(
        "bifurcations/test_bifurcations",
        "test_energies_of_other_saddles_are_reproducible",
        arguments={"name": (0.1883, 0.1885)},
    ),
    Small(
        "bifurcations/test_bifurcations",
        "test_energies_of_other_parameters_are_reproducible",
        arguments={"energies": (-0.1637, -0.1633), "kind": "saddle-node"},
    ),
    Small("bifurcations/test_bifurcations", "test_connections_of_a_strongly_unstable_orbit_are_followed_to_their_fold"),
    Small(
        "tubes/test_extended",
        "test_free_propagation_in_extended_precision_reaches_both_orbits",
        parameter=("down-up", "down-up", -0.07, 0),
    ),
    Small("tubes/test_extended", "test_the_state_is_independent_of_the_length_of_the_leads"),
    Small("bench/test_chart_accuracy", "test_errors_are_the_same_when_a_chart_is_drawn_again"),
    Small(
        "bench/test_chart_accuracy",
        "test_ticks_of_the_plant_are_at_rounding_and_of_the_model_below_an_encoder_count",
    ),
    Small("bench/test_chart_accuracy", "test_refined_connections_are_at_rounding_and_two_flights_are_not"),
    Small("bench/test_chart_accuracy", "test_more_points_on_the_same_intervals_are_nearer_and_cost_the_same"),
    Small(
        "loop/test_margins",
        "test_a_flight_has_on_an_orbit_the_margins_of_the_orbit",
        {"RATE": 200.0},
    ),
    Small(
        "planner/test_planner_numbers",
        "test_a_saved_itinerary_takes_few_clicks_and_a_minute_and_arms_move_smoothly",
        {
            "ENERGY": "-0.07",
            "CONNECTIONS": ("down-up>down-up", "down-up>down-up"),
            "SECONDS": NEVER,
            "ANSWER": NEVER,
            "INTERVAL": NEVER,
            "WATCHED": 1.0,
        },
        prints=("6 clicks, ", " ms apart\n"),
    ),
    Small(
        "planner/test_planner_numbers",
        "test_the_film_in_readme_shows_the_planner_in_use",
        # Fewer frames, of which each movement of the pointer takes the same number.
        {"ENERGY": "-0.07", "CONNECTIONS": ("down-up>down-up", "down-up>down-up"), "RATE": 4, "LONGEST": 25.0},
    ),
    Small(
        "rig/test_hostile_packets",
        "test_a_run_under_a_hundred_thousand_packets_obeys_its_loop_only_and_logs_the_flood",
        {"MANY": 2000, "PAUSE": 0.02},
    ),
    Small("bench/test_edges_control", "test_mismatch_ends_where_the_eigenvalue_leaves_the_circle"),
    Small("bench/test_edges_estimation", "test_a_stuck_encoder_is_reported_after_what_must_pass_and_not_long_after"),
]

IN_SMALL = {
    (
        "loop/test_where_the_loop_fails",
        "test_in_two_hundred_runs_of_all_that_can_go_wrong_the_cart_stays_inside_its_limits",
    ): "test_the_cart_stays_inside_its_limits_in_all_failures",
    (
        "runs/test_campaign",
        "test_a_thousand_runs_with_a_killed_dask_worker_and_a_restarted_scheduler_give_the_same_table",
    ): "test_a_killed_dask_worker_and_a_restarted_scheduler_change_nothing_in_the_table",
    (
        "proofs/test_proofs_of_random_walks",
        "test_three_of_four_random_walks_are_proved",
    ): "test_random_walks_are_proved_and_reported",
    (
        "loop/test_margins",
        "test_a_kept_orbit_is_lost_where_its_margins_end",
    ): "test_a_held_equilibrium_is_lost_where_its_margins_end",
    (
        "rig/test_recovery_on_the_bench",
        "test_a_run_on_the_example_bench_falls_and_resumes_by_itself",
    ): "test_a_night_on_the_example_bench_rolls_its_logs_and_continues_after_a_fall",
    (
        "bench/test_edges_ogy",
        "test_the_border_at_eight_sections_lies_where_it_did",
    ): "test_one_section_per_period_is_lost_at_any_real_resolution_with_a_reason",
    (
        "plans/test_transfers",
        "test_twelve_is_planned_from_its_file_alone_within_its_limits",
    ): "test_transitions_fill_a_square_and_are_refused_where_there_are_none",
}
"""Benchmarks whose small size is another test of their module, by module and function."""

WITHOUT = {
    (
        "cli/test_preflight_verb",
        "test_the_document_has_the_probability_endings_limits_and_helpful_changes",
    ): "the guide's own preflight runs with the slow tests, and a preflight has no smaller size",
}
"""Reasons of benchmarks without a small size, by module and function."""
