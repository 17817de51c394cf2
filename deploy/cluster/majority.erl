%% A node keeps its clients only while it sees most of its cluster: at any other they hear nothing of the rest.
%% RabbitMQ's cluster_partition_handling does nothing with Khepri (https://www.rabbitmq.com/docs/partitions).
-module(majority).
-export([start/0]).

-define(LOOK_MS, 1000).
%% A node that was lost does not count for this long, even if it is back: nodes that lost this one have dropped its
%% clients' queues. Longer than one node's loss is noticed behind another's (net_ticktime).
-define(STEADY_MS, 3000).

start() -> spawn(fun keep/0).

%% RabbitMQ may be stopped between a look and what follows from it, which ends the process that looks.
keep() ->
    {_, Monitor} = spawn_monitor(fun begin_watch/0),
    receive {'DOWN', Monitor, process, _, _} -> timer:sleep(?LOOK_MS) end,
    keep().

begin_watch() ->
    case rabbit:is_running() andalso net_kernel:monitor_nodes(true) of
        ok -> watch(unknown, #{});
        _ -> timer:sleep(?LOOK_MS), begin_watch()
    end.

%% What `Served` was done last, `unknown` where another process or a RabbitMQ before this one may have done it.
watch(Served, Lost) ->
    Down = receive
        {nodedown, Node} -> [Node];
        {nodeup, _} -> []
    after ?LOOK_MS -> []
    end,
    Now = erlang:monotonic_time(millisecond),
    Recent = maps:filter(fun(_, Then) -> Now - Then < ?STEADY_MS end, Lost),
    NowLost = maps:merge(Recent, maps:from_keys(Down, Now)),
    Serves = sees_most(maps:keys(NowLost)),
    watch(case rabbit:is_running() of true -> turn(Served, Serves); false -> unknown end, NowLost).

sees_most(Lost) ->
    {ok, {Members, _}} = application:get_env(rabbit, cluster_nodes),
    Seen = [Node || Node <- [node() | nodes()] -- Lost, lists:member(Node, Members)],
    2 * length(Seen) > length(Members).

%% What is not done is tried again with the next look.
turn(true, true) ->
    true;
turn(Served, true) ->
    Served =:= false andalso logger:warning("majority: this node sees most of its cluster, and takes clients"),
    rabbit_maintenance:is_being_drained_local_read(node())
        orelse rabbit_maintenance:resume_all_client_listeners() =:= ok;
turn(Served, false) ->
    Served =:= false
        orelse logger:warning("majority: this node does not see most of its cluster, and takes no clients"),
    rabbit_maintenance:suspend_all_client_listeners(),
    rabbit_mqtt:close_local_client_connections(no_majority),
    false.
