%% A node keeps its clients only while it sees most of its cluster: at any other they hear nothing of the rest. Of two that
%% do not see each other, while a third sees both, the one whose name sorts last keeps none either.
%% RabbitMQ's cluster_partition_handling does nothing with Khepri (https://www.rabbitmq.com/docs/partitions).
-module(majority).
-export([start/0, takes_clients/0]).

-define(LOOK_MS, 1000).
%% A node that was lost does not count for this long, even if it is back: nodes that lost this one have dropped its
%% clients' queues. Longer than one node's loss is noticed behind another's (net_ticktime).
-define(STEADY_MS, 3000).
%% For this long a node has to be seen by another that sees this one, before it counts as cut off from this one alone:
%% longer than the nodes differ in when they notice that a node is gone.
-define(TORN_MS, 2000).
%% Whoever connects here is told "up" while this node takes clients: what a balancer asks, whatever fleets there are.
-define(PORT, 8880).

start() -> spawn(fun answer/0), spawn(fun keep/0).

answer() ->
    {_, Monitor} = spawn_monitor(
                     fun() ->
                             {ok, Listening} = gen_tcp:listen(?PORT, [{active, false}, {reuseaddr, true}]),
                             answer(Listening)
                     end),
    receive {'DOWN', Monitor, process, _, _} -> timer:sleep(?LOOK_MS) end,
    answer().

answer(Listening) ->
    {ok, Socket} = gen_tcp:accept(Listening),
    [gen_tcp:send(Socket, "up") || takes_clients()],
    gen_tcp:close(Socket),
    answer(Listening).

takes_clients() ->
    persistent_term:get(?MODULE, false)
        andalso rabbit:is_running() andalso is_pid(whereis(rabbit_mqtt_sup))
        andalso not rabbit_maintenance:is_being_drained_local_read(node()).

%% RabbitMQ may be stopped between a look and what follows from it, which ends the process that looks.
keep() ->
    {_, Monitor} = spawn_monitor(fun begin_watch/0),
    receive {'DOWN', Monitor, process, _, _} -> timer:sleep(?LOOK_MS) end,
    keep().

begin_watch() ->
    case rabbit:is_running() andalso net_kernel:monitor_nodes(true) of
        ok -> watch(unknown, #{}, #{});
        _ -> timer:sleep(?LOOK_MS), begin_watch()
    end.

%% What `Served` was done last, `unknown` where another process or a RabbitMQ before this one may have done it. `Lost` has
%% when nodes were lost, `Torn` since when nodes are cut off from this one alone, or `known` after ?TORN_MS.
watch(Served, Lost, Torn) ->
    Down = receive
        {nodedown, Node} -> [Node];
        {nodeup, Node} -> [Node || maps:get(Node, Torn, none) =:= known]
    after ?LOOK_MS -> []
    end,
    Now = erlang:monotonic_time(millisecond),
    Recent = maps:filter(fun(_, Then) -> Now - Then < ?STEADY_MS end, Lost),
    NowLost = maps:merge(Recent, maps:from_keys(Down, Now)),
    {ok, {Members, _}} = application:get_env(rabbit, cluster_nodes),
    Seen = [Each || Each <- [node() | nodes()] -- maps:keys(NowLost), lists:member(Each, Members)],
    Others = Seen -- [node()],
    Since = maps:from_list([{Each, maps:get(Each, Torn, Now)} || Each <- Members -- Seen, is_torn(Each, Others, Torn)]),
    New = [Each || Each := Then <- Since, is_integer(Then), Now - Then >= ?TORN_MS],
    NowTorn = maps:merge(Since, maps:from_keys(New, known)),
    %% Clients that a node has may stay until that is known; a node that has none, because it starts, takes none so long.
    Stands = [Each || Each := Then <- NowTorn, Each < node(), Then =:= known orelse Served =/= true] =:= [],
    Serves = Stands andalso 2 * length(Seen) > length(Members),
    persistent_term:put(?MODULE, Serves),
    %% A leader that reaches both: the two ends would depose each other, and nobody could subscribe.
    lists:member(known, maps:values(NowTorn)) andalso spawn(fun() -> rabbit_khepri:transfer_leadership(Others) end),
    %% Nothing else may try to reach a node that was lost (https://github.com/rabbitmq/rabbitmq-server/issues/12934).
    [spawn(fun() -> net_kernel:connect_node(Each) end) || Each <- Members -- [node() | nodes()]],
    %% The other end has dropped the queues of this node's clients.
    Serves andalso New =/= [] andalso rabbit_mqtt:close_local_client_connections(torn),
    watch(case rabbit:is_running() of true -> turn(Served, Serves, Seen); false -> unknown end, NowLost, NowTorn).

%% Whether a node, which does not count, is away and seen by another, or was so and is not yet back for long enough.
is_torn(Node, Others, Torn) ->
    case lists:member(Node, nodes()) of
        true -> maps:get(Node, Torn, none) =:= known;
        false -> lists:any(fun(Each) -> lists:member(Node, seen_by(Each)) end, Others)
    end.

seen_by(Node) ->
    try erpc:call(Node, erlang, nodes, [], 500)
    catch error:{erpc, _} -> []
    end.

%% What is not done is tried again with the next look.
turn(true, true, _) ->
    true;
turn(Served, true, Seen) ->
    Served =:= false andalso logger:warning("majority: this node sees ~tp, and takes clients", [Seen]),
    rabbit_maintenance:is_being_drained_local_read(node())
        orelse rabbit_maintenance:resume_all_client_listeners() =:= ok;
turn(Served, false, Seen) ->
    Served =:= false orelse logger:warning("majority: this node sees only ~tp, and takes no clients", [Seen]),
    rabbit_maintenance:suspend_all_client_listeners(),
    rabbit_mqtt:close_local_client_connections(no_majority),
    false.
