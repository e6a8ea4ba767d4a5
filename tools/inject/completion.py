"""A completion script for bash: actions, units, kinds and keys of `hilsat inject`."""

from __future__ import annotations

import shlex

from plant_server.faults import FAMILIES, KINDS, UNITS
from plant_server.faults.fault import magnitudes_of
from tools.inject.request_words import ACTIONS

OPTIONS = "--at --at-tick --for --until --id --profile --wait --timeout --json --run"
SCRIPT = """\
# completion of `hilsat inject` for bash: source this, or `source <(hilsat inject completion bash)`
_hilsat_inject() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} at=2 choices= key
    if [[ ${{COMP_WORDS[1]}} != inject ]]; then
        ((COMP_CWORD == 1)) && mapfile -t COMPREPLY < <(compgen -W {verbs} -- "$word")
        return
    fi
    [[ ${{COMP_WORDS[2]}} == set ]] && at=3
    local unit=${{COMP_WORDS[at]}} kind=${{COMP_WORDS[at + 1]}}
    if ((COMP_CWORD == 2)); then
        choices={first}
    elif ((COMP_CWORD == at)); then
        choices={units}
    elif [[ ${{COMP_WORDS[2]}} == catalogue || ${{COMP_WORDS[2]}} == clear ]]; then
        choices={units}
    elif ((COMP_CWORD == at + 1)); then
        case ${{unit%%.*}} in
{kinds}
        esac
    elif ((COMP_CWORD > at + 1)); then
        choices={options}
        case ${{unit%%.*}}/$kind in
{keys}
        esac
    fi
    mapfile -t COMPREPLY < <(compgen -W "$choices" -- "$word")
    [[ ${{#COMPREPLY[@]}} == 1 && ${{COMPREPLY[0]}} == *= ]] && compopt -o nospace
}}
complete -o default -F _hilsat_inject hilsat
"""


def write_completion(verbs: tuple[str, ...]) -> str:
    """Return the script. verbs : of the hilsat command"""
    kinds = [f"            {family}) choices={shlex.quote(' '.join(KINDS[family]))} ;;" for family in FAMILIES]
    keys = [
        f"            {family}/{name}) choices+={shlex.quote(''.join(f' {key}=' for key in magnitudes_of(cls)))} ;;"
        for family in FAMILIES
        for name, cls in KINDS[family].items()
        if magnitudes_of(cls)
    ]
    return SCRIPT.format(
        verbs=shlex.quote(" ".join(verbs)),
        first=shlex.quote(" ".join([*ACTIONS, *UNITS])),
        units=shlex.quote(" ".join(UNITS)),
        options=shlex.quote(OPTIONS),
        kinds="\n".join(kinds),
        keys="\n".join(keys),
    )
