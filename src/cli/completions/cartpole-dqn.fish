# Completions of cartpole-dqn for fish: cartpole-dqn completions fish | source
function __cartpole_dqn_complete
    set -l words (commandline --current-process --tokenize --cut-at-cursor)
    set -l token (commandline --current-token --cut-at-cursor)
    set -l program (string replace --regex '^~/' "$HOME/" -- $words[1])
    command --query $program; or set program cartpole-dqn
    # What stands before a path, as in --out=runs/x.
    set -l option (string match --regex '^--[^=]*=' -- $token)
    set -l path (string replace --regex '^--[^=]*=' '' -- $token)
    for line in ($program __words -- $words[2..] "$token" 2>/dev/null)
        switch $line
            case ':files*'
                printf '%s\n' "$option"(complete -C "'' $path")
            case ':directories*'
                printf '%s\n' "$option"(complete -C "'' $path" | string match --regex '^.*/(?=\t|$)')
            case '*'
                printf '%s\n' $line
        end
    end
end
complete --command cartpole-dqn --no-files --keep-order --arguments '(__cartpole_dqn_complete)'
