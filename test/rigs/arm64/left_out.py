# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which tests cannot hold in the root, each with the reason; a real arm64 machine has no such."""

LEFT_OUT = {
    'qemu-user has no TCSETS2, and tcgetattr reads a rate of 1000000 back as 0': [
        'test/test_listener.py::test_lost_port_is_set_up_anew_at_its_rate',
        'test/test_deadman.py::test_a_port_that_comes_back_to_a_dead_or_frozen_bridge_is_found_and_'
        'the_rover_stops',
    ],
    'qemu-user has the program of the process open where a closed standard input was': [
        'test/test_dump.py::test_streams_that_are_closed_are_no_traceback'
        '[dxl_dump - --summary <&--0]',
    ],
    'qemu-user has no TIOCGEXCL, and the root of a namespace opens no port that is kept for one': [
        'test/test_link.py::test_closing_gives_the_port_back_to_everybody',
    ],
    'the command line of each process begins with the emulator': [
        'test/test_deadman.py::test_pkill_of_all_that_carry_the_name_stops_the_rover',
    ],
    'they install with pip, which the root has not': [
        'test/test_packaging.py',
        'test/test_wheel.py',
    ],
    'the namespace has one user and one group, so that no file can be given to another': [
        'test/test_port.py::test_permission_names_user_groups_and_command',
    ],
}
