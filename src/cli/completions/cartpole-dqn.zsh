#compdef cartpole-dqn
# Completions of cartpole-dqn for zsh, after compinit: source <(cartpole-dqn completions zsh)
_cartpole_dqn() {
    local program=${words[1]/#\~\//$HOME/} line value request=
    local -a plain open
    whence -p -- $program >/dev/null || program=cartpole-dqn
    for line in ${(f)"$($program __words -- "${(@Q)words[2,CURRENT-1]}" "${(Q)PREFIX}" 2>/dev/null)"}; do
        value=${line%%$'\t'*}
        case $value in
            :*) request=$value ;;
            *=) open+=("${value//:/\\:}:${line#*$'\t'}") ;;
            *) plain+=("${value//:/\\:}:${line#*$'\t'}") ;;
        esac
    done
    (( $#open )) && _describe key open -S ''
    (( $#plain )) && _describe candidate plain
    [[ $PREFIX == --*=* ]] && compset -P '--*='
    case $request in
        :files) _files ;;
        :directories) _files -/ ;;
    esac
}
if [[ $funcstack[1] == _cartpole-dqn ]]; then
    _cartpole_dqn "$@"
else
    compdef _cartpole_dqn cartpole-dqn
fi
