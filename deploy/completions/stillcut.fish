# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_stillcut_global_optspecs
    string join \n h/help V/version
end

function __fish_stillcut_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_stillcut_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_stillcut_using_subcommand
    set -l cmd (__fish_stillcut_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c stillcut -n "__fish_stillcut_needs_command" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_needs_command" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "demo" -d 'Shows the whole system on a virtual lathe: chatter grows, is heard, is silenced'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "run" -d 'Runs the service until it is told to stop'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "lathe" -d 'Runs the virtual lathe alone, in real time: servo samples at 9 kHz out, turret commands in'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "simulate" -d 'Writes a recording from the simulator: what an ideal dynamometer and probe would see'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "replay" -d 'Runs the live pipeline over a recording and writes events.jsonl and track.parquet'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "force" -d 'Estimates cutting force from servo signals or accelerometers'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "identify" -d 'Finds mechanical parameters and dead times from a sweep, or makes the accelerometer estimator'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "resolution" -d 'Force variance caused by encoder quantization, and error budgets of the observers'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "import" -d 'Turns a foreign CSV, Parquet or MAT file into a recording'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "pitch" -d 'Gives the optimum pitch angle difference and how far tool 1 must move for it'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "stability" -d 'Maps where two opposed tools chatter: growth and frequency over pitch difference, position, speed, width'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "diagnose" -d 'Says what physics a machine model, or the scenario of a cut, leaves out'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "conceal" -d 'Judges the diagnosis blind on simulated machines with a hidden effect'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "campaign" -d 'Closes the loop on random cuts: how many that chatter end stable, against what the model says can'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "print-config" -d 'Prints every setting of the service with its default, unit and meaning'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "print-model" -d 'Prints a commented machine model to start from; what is left out of it is estimated'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "completions" -d 'Prints what a shell needs to complete the commands and their options'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "man" -d 'Prints the manual page, all commands in one'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "token" -d 'Makes an access token: prints it once, and adds its SHA-256 to the file of tokens'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "audit" -d 'Checks the audit record: every row\'s hash covers the row before it'
complete -c stillcut -n "__fish_stillcut_needs_command" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -l duration-s -d 'Machine time to run for, in s; Ctrl-C ends it earlier' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -l mode -d 'How far the service goes: observe, advise or act' -r -f -a "observe\t''
advise\t''
act\t''"
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -l seed -d 'Seed of everything random' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -l scenario -d 'Scenario (lathe.toml); without it, the bar and cut of the README\'s example' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -l json -d 'Print one JSON object at the end and nothing else'
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand demo" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand run" -l config -d 'Configuration; without it every setting has the default that `print-config` shows' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand run" -l check -d 'Only read the configuration and the files that it names, and say whether they are good'
complete -c stillcut -n "__fish_stillcut_using_subcommand run" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand run" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -l config -d 'Scenario (lathe.toml); without it, the bar and cut of the README\'s example' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -l prefix -d 'Prefix of the shared memory domain; the same as the service\'s `transport.prefix`' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -l root -d 'Folder of the domain; the same as the service\'s `transport.root`' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -l duration-s -d 'Machine time after which to stop, in s; without it, until Ctrl-C' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -l entry-s -d 'Time in air before the tools enter the cut, in s' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -l seed -d 'Seed of everything random' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand lathe" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l scenario -d 'Scenario (contracts, section 3); keys not given have their defaults' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l duration-s -d 'How long to cut, in s' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l out -d 'Recording to write (Parquet)' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l force-noise-ratio -d 'Random part of the cutting force over the force (default 0, with --servo 0.03)' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l entry-s -d 'Time in air before the tools enter the cut, in s' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l seed -d 'Seed of everything random' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l force-bandwidth-hz -d 'Show the forces through a low-pass of this corner, in Hz, and state it (default: none)' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l force-delay-s -d 'Show the forces so late, in s, and state it' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -l servo -d 'Add the servo columns of each turret axis'
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand simulate" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l config -d 'Configuration of the service' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l recording -d 'Recording, Parquet or CSV' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l out -d 'Folder to write into' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l band-hz -d 'Band to watch, "low,high"; otherwise the configuration\'s, the recording\'s, or its workpiece\'s' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l spindle-speed-rpm -d 'Spindle speed where the recording has none' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l signal -d 'Columns to listen to as they are, where there are no servo signals: force_n or accel_m_s2' -r -f -a "force_n\t''
accel_m_s2\t''"
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -l verify -d 'Fail unless the recording carries what the live service decided and this replay decides the same, bit for bit. Needs the configuration that the service ran with'
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand replay" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l model -d 'Machine model; needed by every method but frf' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l recording -d 'Recording to work on' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l method -d 'thrust, dob, medob, rigid_mode, vibration_mode, second_vibration_mode, fitted, spectral or frf' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l out -d 'Where the estimate goes (Parquet)' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l estimator -d 'Accelerometer estimator (method frf), as `identify --method frf` writes it' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l idle -d 'Air-cutting run of the same motion, whose disturbance is taken off by position; repeatable' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l beside -d 'A second method beside the first (frf too): how far they disagree goes into the metadata' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l notch -d 'Notch at a frequency in Hz, or following motor_encoder or stage_encoder; repeatable' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l turns -d 'Length of the window in turns of the spindle (fitted, spectral)' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l harmonics -d 'Number of harmonics (fitted, spectral); as many as lie below 500 Hz when not given' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l teeth -d 'Teeth of the tool: only multiples of the tooth-pass frequency are taken (fitted, spectral)' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l reading -d 'Where a window is read: middle (least noise; when not given) or young (three samples from its young end: shortest delay) (fitted, spectral)' -r -f -a "middle\t''
young\t''"
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l pass-hz -d 'Low-pass behind the balance: flat to here, same delay at every frequency' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l cutoff-hz -d 'Fourth-order Butterworth low-pass at this frequency instead, as in the live pipeline' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l motor-cutoff-hz -d 'Above this the drive side is not listened to, as in the live pipeline' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l keep-stiffness -d 'Keeps the model\'s axial stiffness although the recording shows another (vibration_mode)'
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -l live -d 'Only what the live pipeline can do: nothing that needs the whole recording (axial stiffness, zero of a standing axis, median spindle speed, ends of frf)'
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -s h -l help -d 'Print help'
complete -c stillcut -n "__fish_stillcut_using_subcommand force" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -l method -d 'sweep: parameters from a swept-sine recording; frf: estimator from runs with known force' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -l model -d 'Model to start from (sweep)' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -l recording -d 'Recording; repeatable' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -l torque-constant-error-percent -d 'How well the torque constant is known, per cent, one standard deviation (sweep)' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -l instant-error-us -d 'How well the instants are known at which the drive takes its reference and its encoders, us, one standard deviation (sweep); without it a tenth of a sample' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -l out -d 'Where the result goes: a model (sweep) or an estimator (frf)' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -s h -l help -d 'Print help'
complete -c stillcut -n "__fish_stillcut_using_subcommand identify" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l model -d 'Machine model' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l cutoff-hz -d 'Cutoffs of the observer\'s low-pass' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l rate-hz -d 'Rate of the estimation; the model\'s when not given' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l out -d 'Picture of variance over encoder step (SVG)' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l loop-disturbance-cutoff-rad-s -d 'The axis\' control cancels disturbances behind a low-pass of this cutoff (with --budget)' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l budget -d 'Adds the error of each observer for wrong masses, stiffness, delays and encoder steps, and what its estimate is made of'
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -l json -d 'One JSON object instead of a table'
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -s h -l help -d 'Print help'
complete -c stillcut -n "__fish_stillcut_using_subcommand resolution" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand import" -l map -d 'What the columns are' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand import" -l out -d 'Recording to write' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand import" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand import" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -l spindle-speed-rpm -d 'Speed of the workpiece' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -l chatter-frequency-hz -d 'Highest chatter frequency heard' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -l diameter-mm -d 'Diameter at the tools' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -l lobe -d 'm of eq. (6-10): 0 keeps the shift, and with it the change of the rake angle, small' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -l json -d 'One JSON object instead of text'
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand pitch" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l scenario -d 'lathe.toml' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l out -d 'Folder to write stability.parquet and stability.svg into' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l cuts -d 'Table of cuts: cuts.parquet is written instead, with what the scenario foretells of each row' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l pitch-rad -d 'Pitch angle difference, from:to:count' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l position-m -d 'Tools from the chuck, from:to:count' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l speed-rpm -d 'Spindle speed, from:to:count' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -l width-m -d 'Width of cut, from:to:count' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand stability" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l model -d 'The machine\'s model: what does the drive leave out?' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l scenario -d 'The scenario of a cut: what does the cut leave out?' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l recording -d 'A recording of the machine; may be given several times' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l cuts -d 'A table of cuts (stillcut.cuts/1, Parquet or CSV), beside the recordings or instead of them' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l out -d 'Folder for diagnosis.json, report.html, model.toml (scenario.toml) and the contributions' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l budget-s -d 'Seconds within which the answer stands: work is counted, so a busy machine answers later, not differently' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l plan -d 'Print the smallest set of cuts that would tell the alternatives apart'
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -l progress -d 'Write lines `progress SHARE WHAT` to standard error, for programs that watch'
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand diagnose" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l model -d 'Model to draw machines around: an axis of two inertias' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l scenario -d 'Scenario to draw machines around: the diagnosis of the cut is judged, on five recordings a machine' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l effects -d 'Effects to hide, comma separated; `a+b` hides two at once; `healthy` hides nothing' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l depths -d 'Depths: 1 is a plain effect, 0.1 a tenth of it' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l seeds -d 'Machines per effect and depth' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l first-seed -d 'First seed' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l model-error -d 'How far the model\'s constants are off, standard deviation as a share' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l background -d 'Size of background disturbances: 1 is a quiet axis' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l out -d 'Folder for the results' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -l cases-only -d 'Only writes the cases as folders (model, recordings, truth.json); no diagnosis'
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand conceal" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l cuts -d 'Number of cuts' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l seed -d 'First seed' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l duration-s -d 'Machine time of each cut, s' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l rule -d 'How the pitch is chosen: by the identified two-delay model, or by eq. (6-10) alone' -r -f -a "model\t''
opposed\t''"
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l conceal -d 'Physics beyond the two-delay model that the cuts have, one of these each; comma separated, or `all`' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l told -d 'What the controller is told: nominal numbers without that physics, what a diagnosis of three cuts makes of these, or the truth with its numbers a little off' -r -f -a "stated\t''
repaired\t''
truth\t''"
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l out -d 'Folder for campaign.csv; without it only the table is printed' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l wide -d 'Wider ranges: slim and stout bars, little and much damping, deep cuts, slow and fast spindles'
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l before-chatter -d 'The pitch moves before chatter too, where the stability margin runs out'
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -l outward -d 'The tools travel from near the chuck toward the free end: the cut begins silent and loses its margin'
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand campaign" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand print-config" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand print-config" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand print-model" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand print-model" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand completions" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand completions" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand man" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand man" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand token" -l file -d 'File of tokens, as `http.tokens` names it; made with mode 600 where it is not there' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand token" -l name -d 'Whose token it is: letters, digits, `.`, `-`, `_`' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand token" -l role -d 'viewer, operator or engineer' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand token" -l days -d 'Days until it expires, 1 to 3650' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand token" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c stillcut -n "__fish_stillcut_using_subcommand token" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and not __fish_seen_subcommand_from verify help" -s h -l help -d 'Print help'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and not __fish_seen_subcommand_from verify help" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and not __fish_seen_subcommand_from verify help" -f -a "verify" -d 'Reads the whole chain; says where it breaks, with status 1 when it does'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and not __fish_seen_subcommand_from verify help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from verify" -l config -d 'Configuration that names the folder of the history' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from verify" -l history -d 'History file itself' -r -F
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from verify" -l head -d 'Hash of the last row as it was noted earlier: notices a cut-off end' -r
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from verify" -s h -l help -d 'Print help'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from verify" -s V -l version -d 'Print version'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from help" -f -a "verify" -d 'Reads the whole chain; says where it breaks, with status 1 when it does'
complete -c stillcut -n "__fish_stillcut_using_subcommand audit; and __fish_seen_subcommand_from help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "demo" -d 'Shows the whole system on a virtual lathe: chatter grows, is heard, is silenced'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "run" -d 'Runs the service until it is told to stop'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "lathe" -d 'Runs the virtual lathe alone, in real time: servo samples at 9 kHz out, turret commands in'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "simulate" -d 'Writes a recording from the simulator: what an ideal dynamometer and probe would see'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "replay" -d 'Runs the live pipeline over a recording and writes events.jsonl and track.parquet'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "force" -d 'Estimates cutting force from servo signals or accelerometers'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "identify" -d 'Finds mechanical parameters and dead times from a sweep, or makes the accelerometer estimator'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "resolution" -d 'Force variance caused by encoder quantization, and error budgets of the observers'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "import" -d 'Turns a foreign CSV, Parquet or MAT file into a recording'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "pitch" -d 'Gives the optimum pitch angle difference and how far tool 1 must move for it'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "stability" -d 'Maps where two opposed tools chatter: growth and frequency over pitch difference, position, speed, width'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "diagnose" -d 'Says what physics a machine model, or the scenario of a cut, leaves out'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "conceal" -d 'Judges the diagnosis blind on simulated machines with a hidden effect'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "campaign" -d 'Closes the loop on random cuts: how many that chatter end stable, against what the model says can'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "print-config" -d 'Prints every setting of the service with its default, unit and meaning'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "print-model" -d 'Prints a commented machine model to start from; what is left out of it is estimated'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "completions" -d 'Prints what a shell needs to complete the commands and their options'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "man" -d 'Prints the manual page, all commands in one'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "token" -d 'Makes an access token: prints it once, and adds its SHA-256 to the file of tokens'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "audit" -d 'Checks the audit record: every row\'s hash covers the row before it'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and not __fish_seen_subcommand_from demo run lathe simulate replay force identify resolution import pitch stability diagnose conceal campaign print-config print-model completions man token audit help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c stillcut -n "__fish_stillcut_using_subcommand help; and __fish_seen_subcommand_from audit" -f -a "verify" -d 'Reads the whole chain; says where it breaks, with status 1 when it does'
