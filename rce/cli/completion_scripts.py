"""Completion scripts of shells.

Each script calls `rce complete` with the words up to the cursor, the last one incomplete.
"""

from __future__ import annotations

BASH = """\
# bash completion of rce: save as ~/.local/share/bash-completion/completions/rce
_rce() {
    local words cword cur candidates
    # words as the shell splits them, but not at : and =
    if declare -F _get_comp_words_by_ref > /dev/null; then
        _get_comp_words_by_ref -n := words cword
    else
        words=("${COMP_WORDS[@]}")
        cword=$COMP_CWORD
    fi
    cur=${words[cword]}
    mapfile -t candidates < <("${words[0]}" complete "${words[@]:1:cword}" 2> /dev/null | cut -f 1)
    mapfile -t COMPREPLY < <(compgen -W "${candidates[*]}" -- "$cur")
    [[ ${#COMPREPLY[@]} -gt 0 && ${COMPREPLY[0]} == */ ]] && compopt -o nospace
    if declare -F __ltrimcolon_completions > /dev/null; then
        __ltrimcolon_completions "$cur"
    fi
    return 0
}
complete -o default -F _rce rce
"""

ZSH = """\
#compdef rce
# zsh completion of rce: save as _rce in a directory of $fpath
_rce() {
    local -a candidates
    candidates=(${(f)"$(${words[1]} complete "${(@)words[2,CURRENT]}" 2> /dev/null)"})
    if (( ${#candidates} == 0 )); then
        _files
        return
    fi
    candidates=(${candidates//:/\\\\:})
    candidates=(${candidates/$'\\t'/:})
    _describe 'rce' candidates
}
if [ "$funcstack[1]" = "_rce" ]; then
    _rce "$@"
else
    compdef _rce rce
fi
"""

FISH = """\
# fish completion of rce: save as ~/.config/fish/completions/rce.fish
function __rce_complete
    set -l words (commandline -opc) (commandline -ct)
    $words[1] complete $words[2..-1] 2> /dev/null
end
complete -c rce -f -a '(__rce_complete)'
"""

SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}
