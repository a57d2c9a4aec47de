# Completions of cartpole-dqn for bash 3.2 and later: source <(cartpole-dqn completions bash)
_cartpole_dqn() {
    local program=${1/#\~\//$HOME/} rest=${COMP_LINE:0:COMP_POINT} word='' strip='' breaks line value
    local -a words=()
    type -P "$program" >/dev/null || program=cartpole-dqn
    # Bash splits words at = and :, and here they are parts of a word. Pieces with no blank between them are one word.
    local i piece trimmed
    for ((i = 0; i <= COMP_CWORD; i++)); do
        trimmed=${rest#"${rest%%[![:blank:]]*}"}
        piece=${COMP_WORDS[i]}
        if ((i == COMP_CWORD)); then piece=$trimmed; fi
        if ((i > 0)) && [[ -n $trimmed && $trimmed == "$rest" ]]; then
            word+=$piece
        else
            if ((i > 0)); then words+=("$word"); fi
            word=$piece
        fi
        rest=${trimmed#"$piece"}
    done
    COMPREPLY=()
    # The part that bash does not replace. Within quotes it replaces the whole word.
    if [[ $word == [\"\']* ]]; then
        word=${word:1}
    else
        breaks=${COMP_WORDBREAKS//[^=:]/}
        if [[ -n $breaks && $word == *[$breaks]* ]]; then strip=${word%"${word##*[$breaks]}"}; fi
    fi
    while IFS= read -r line; do
        value=${line%%$'\t'*}
        case $value in
            :files) while IFS= read -r line; do COMPREPLY+=("$line"); done < <(compgen -f -- "$2") ;;
            :directories) while IFS= read -r line; do COMPREPLY+=("$line"); done < <(compgen -d -- "$2") ;;
            *) COMPREPLY+=("${value#"$strip"}") && continue ;;
        esac
        compopt -o filenames 2>/dev/null
    done < <("$program" __words -- "${words[@]:1}" "$word" 2>/dev/null)
    if [[ ${COMPREPLY-} == *= ]]; then compopt -o nospace 2>/dev/null; fi
}
complete -F _cartpole_dqn cartpole-dqn
