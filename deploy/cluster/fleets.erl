%% A listener for each fleet, with the fleet's own certificate and its authority alone: RabbitMQ's own listeners share one
%% certificate and trust one list of authorities, each of which could speak for every fleet.
%% RabbitMQ's parameter mqtt_port_to_vhost_mapping says which fleets there are, and takes the clients of a port to the
%% fleet's virtual host. Only its ports are open, so no client gets to a virtual host that is not its port's.
-module(fleets).
-export([start/0, revoke/2]).
-include_lib("rabbit_common/include/rabbit.hrl").

-define(LOOK_MS, 1000).
-define(IDENTITIES, "/fleets").
-define(FILES, [{cacertfile, "fleet.pem"}, {certfile, "certificate.pem"}, {keyfile, "identity.pem"}]).

start() -> spawn(fun keep/0).

%% RabbitMQ may be stopped between a look and what follows from it, which ends the process that looks.
keep() ->
    {_, Monitor} = spawn_monitor(fun() -> watch([], []) end),
    receive {'DOWN', Monitor, process, _, _} -> timer:sleep(?LOOK_MS) end,
    keep().

%% `Files` has the hashes of the fleets' files at the last look; `Missing` are the fleets that had no identity, or could
%% not be listened for.
watch(Files, Missing) ->
    {NowFiles, Now} = case majority:takes_clients() of true -> serve(Files); false -> {Files, []} end,
    [logger:error("fleets: ~ts at port ~b is not served: ~tp", [Fleet, Port, Why])
     || {{Fleet, Port}, Why} <- Now -- Missing],
    timer:sleep(?LOOK_MS),
    watch(NowFiles, Now).

%% A listener's id has its authority: another authority is another listener.
serve(Before) ->
    Files = [{Each, files(Each, Before)} || Each <- mapped()],
    {Readable, Missing} = lists:partition(fun({_, Hashes}) -> lists:all(fun is_binary/1, Hashes) end, Files),
    Wanted = [{fleet, Each, Authority} || {Each, [Authority | _]} <- Readable],
    Present = [Id || {{fleet, _, _} = Id, _, _, _} <- supervisor:which_children(rabbit_mqtt_sup)],
    %% Ends the fleet's connections too.
    [ok = supervisor:terminate_child(rabbit_mqtt_sup, Id) || Id <- Present -- Wanted],
    %% Erlang keeps what it has read of a file for up to two minutes, even if no listener uses it any more.
    Files =:= Before orelse ssl:clear_pem_cache(),
    Started = [{Each, listen(Id)} || {fleet, Each, _} = Id <- Wanted -- Present],
    {Files, [{Each, {no_identity, [Why || Why <- Hashes, is_atom(Why)]}} || {Each, Hashes} <- Missing]
          ++ [Failed || {_, Result} = Failed <- Started, Result =/= ok]}.

mapped() ->
    case rabbit_runtime_parameters:value_global(mqtt_port_to_vhost_mapping) of
        not_found -> [];
        Mapping -> [{Fleet, binary_to_integer(Port)} || {Port, Fleet} <- rabbit_data_coercion:to_proplist(Mapping)]
    end.

%% While files cannot be read the fleet has those that it had: who writes them may give them to this node's user only
%% afterwards. Only those that are gone take it out.
files({Name, _} = Fleet, Before) ->
    Found = [case file:read_file(File) of {ok, Bytes} -> crypto:hash(sha256, Bytes); {error, Why} -> Why end
             || {_, File} <- identity(Name)],
    case lists:all(fun(Each) -> is_binary(Each) orelse Each =:= enoent end, Found) of
        true -> Found;
        false -> proplists:get_value(Fleet, Before, Found)
    end.

identity(Fleet) -> [{Option, filename:join([?IDENTITIES, Fleet, File])} || {Option, File} <- ?FILES].

%% As rabbit_mqtt_sup does it for the listeners of the configuration, but `temporary`: that supervisor would restart, with
%% one that has failed, those of all fleets. The next look starts it again.
listen({fleet, {Fleet, Port}, _} = Id) ->
    {ok, Socket} = application:get_env(rabbitmq_mqtt, tcp_listen_options),
    Tls = lists:foldl(fun({Option, File}, Options) ->
                              lists:keystore(Option, 1, Options, {Option, unicode:characters_to_list(File)})
                      end, rabbit_networking:ensure_ssl(), identity(Fleet)),
    [Address | _] = rabbit_networking:tcp_listener_addresses(Port),
    {_, Start, _, Shutdown, Type, Modules} = rabbit_networking:tcp_listener_spec(
             rabbit_mqtt_listener_sup, Address, Socket ++ Tls, ranch_ssl, rabbit_mqtt_reader, [], 'mqtt/ssl',
             application:get_env(rabbitmq_mqtt, num_ssl_acceptors, 10),
             application:get_env(rabbitmq_mqtt, num_conns_sups, 1), worker, "MQTT TLS listener"),
    case supervisor:start_child(rabbit_mqtt_sup, {Id, Start, temporary, Shutdown, Type, Modules}) of
        {ok, _} -> ok;
        {error, Why} -> Why
    end.

%% Takes a node's permissions in its fleet, then ends its connections there: another fleet may have a node of the same
%% name, which is the same user to RabbitMQ.
revoke(Fleet, Node) ->
    ok = rabbit_auth_backend_internal:clear_permissions(Node, Fleet, <<"fleets">>),
    Own = [Each || #tracked_connection{username = User} = Each <- rabbit_connection_tracking:list(Fleet), User =:= Node],
    rabbit_connection_tracking:close_connections(Own, "revoked", 0).
